// A recording's frames without the damaged ones.
// threads: as FrameSource
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "capture/frames.h"
#include "capture/recording/recording.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Goes on behind what is damaged: the first is logged with its place, at the end their number.
class UndamagedFrames final : public FrameSource {
 public:
  /// Of a recording; every other source is handed on as it is, since there what cannot be read is
  /// a fault of whoever made it.
  /// errors: as open_capture
  static Result<std::unique_ptr<UndamagedFrames>> open(
      const std::filesystem::path& path, RecordedLight light = RecordedLight::kCameras,
      Seconds from = Seconds(0));
  /// Of a capture that is played once more: nothing is logged again.
  void keep_quiet() { quiet_ = true; }

  const std::vector<CameraInfo>& cameras() const override { return whole_->cameras(); }
  double view_rate() const override { return whole_->view_rate(); }
  /// errors: kUnreadable where nothing whole follows for long
  Result<std::optional<Frame>> next() override;
  /// Places at which frames could not be read, or were missing.
  std::uint64_t left_out() const { return left_out_; }

 private:
  UndamagedFrames(std::unique_ptr<FrameSource> whole, std::string name, bool is_recording)
      : whole_(std::move(whole)), name_(std::move(name)), is_recording_(is_recording) {}

  std::unique_ptr<FrameSource> whole_;
  std::string name_;
  bool is_recording_, ended_ = false, quiet_ = false;
  std::uint64_t left_out_ = 0;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
