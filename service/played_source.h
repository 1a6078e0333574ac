// Frames that were taken at another time, or by nobody, played as if cameras took them now.
// threads: as capture::FrameSource
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "capture/frames.h"

namespace penumbra::service {

/// Another source's frames with times of CLOCK_MONOTONIC, each given at its time, as cameras do.
/// The first has the time at which it is asked for, and the others keep their distance from it. A
/// source that has fallen a quarter of a second behind goes on from now. So poses, outputs,
/// headsets and clients that set a frame's time against theirs find them together.
class PlayedSource : public capture::FrameSource {
 public:
  explicit PlayedSource(std::unique_ptr<capture::FrameSource> frames)
      : frames_(std::move(frames)) {}

  const std::vector<capture::CameraInfo>& cameras() const override { return frames_->cameras(); }
  Result<std::optional<capture::Frame>> next() override;
  double view_rate() const override { return frames_->view_rate(); }
  bool is_live() const override { return true; }
  void close() override {
    closed_ = true;
    frames_->close();
  }
  bool take_darker(int camera, double factor) override {
    return frames_->take_darker(camera, factor);
  }
  Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures) override {
    return frames_->set_exposures(camera, exposures);
  }
  std::vector<capture::CameraCounts> counts() const override { return frames_->counts(); }

 private:
  std::unique_ptr<capture::FrameSource> frames_;
  std::optional<std::int64_t> offset_ns_;
  std::atomic<bool> closed_ = false;
};

}  // namespace penumbra::service
