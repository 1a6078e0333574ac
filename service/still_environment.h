// The light of a file as if a camera filmed it, for a rig that has no environment camera.
// threads: as capture::FrameSource
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "calib/track/board_tracker.h"
#include "capture/frames.h"
#include "core/image.h"
#include "core/result.h"

namespace penumbra::service {

struct StillEnvironmentOptions {
  Image<Rgb> map;  // whole, lat-long, in units of its own
  /// Radiance of the view camera over the map's. Nothing: by the paper of the boards that the
  /// camera sees, channel by channel, so that the white balance of the camera counts as well.
  std::optional<double> scale{};
  std::vector<calib::PlacedBoard> boards{};
  double paper_albedo = .8;
};

/// Another source's frames, and one of the map twice a second, from when the scale is known.
class StillEnvironment : public capture::FrameSource {
 public:
  /// errors: kInvalid (neither a scale nor boards; a scale or an albedo that is not positive; a
  ///         source that has an environment camera)
  static Result<std::unique_ptr<StillEnvironment>> create(
      std::unique_ptr<capture::FrameSource> frames, StillEnvironmentOptions options);

  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  Result<std::optional<capture::Frame>> next() override;
  double view_rate() const override { return frames_->view_rate(); }
  bool is_live() const override { return frames_->is_live(); }
  void close() override { frames_->close(); }
  bool take_darker(int camera, double factor) override {
    return frames_->take_darker(camera, factor);
  }
  Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures) override {
    if (camera >= static_cast<int>(frames_->cameras().size()))
      return FrameSource::set_exposures(camera, exposures);  // the map's
    return frames_->set_exposures(camera, exposures);
  }
  std::vector<capture::CameraCounts> counts() const override { return frames_->counts(); }

 private:
  StillEnvironment(std::unique_ptr<capture::FrameSource> frames, StillEnvironmentOptions options)
      : frames_(std::move(frames)), options_(std::move(options)) {}
  void measure(const capture::Frame& view);
  std::optional<Rgb> paper_over_map(const capture::Frame& view) const;
  capture::Frame frame_of_map(TimestampNs time);

  std::unique_ptr<capture::FrameSource> frames_;
  StillEnvironmentOptions options_;
  std::vector<capture::CameraInfo> cameras_;
  std::vector<Rgb> irradiance_;  // of the map on each board
  std::optional<Rgb> scale_, shown_;
  std::shared_ptr<const FramePixels> scaled_;
  std::optional<TimestampNs> measured_, sent_;
  std::optional<capture::Frame> held_;  // comes after the map's
  std::uint64_t sent_frames_ = 0;
};

}  // namespace penumbra::service
