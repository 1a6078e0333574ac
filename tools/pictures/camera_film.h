// One camera's frames of a capture, for the calibrations.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "capture/frames.h"
#include "core/result.h"

namespace penumbra::tools {

/// threads: thread-bound
class CameraFilm {
 public:
  /// `path` names the source in errors.
  /// errors: kNotFound (no camera of that name)
  static Result<CameraFilm> of(std::unique_ptr<capture::FrameSource> source,
                               const std::string& path, const std::string& camera);
  /// errors: as capture::open_capture, of()
  static Result<CameraFilm> open(const std::string& path, const std::string& camera);

  const capture::CameraInfo& camera() const { return source_->cameras()[index_]; }
  /// The camera's next frame, or nothing at the end.
  Result<std::optional<capture::Frame>> next();

 private:
  CameraFilm(std::unique_ptr<capture::FrameSource> source, std::size_t index)
      : source_(std::move(source)), index_(index) {}
  std::unique_ptr<capture::FrameSource> source_;
  std::size_t index_;
};

}  // namespace penumbra::tools
