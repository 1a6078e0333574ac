// What clients ask of the cameras while they film.
// threads: thread-safe
#pragma once

#include <mutex>
#include <string>
#include <vector>

#include "capture/frames.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::service {

class CameraControl {
 public:
  /// Of the frames that the service takes, which outlive this; null: there are none any more.
  void attach(capture::FrameSource* source);
  /// Exposures in turn, or those that the rig file gives the camera where there are none.
  /// errors: kNotFound (no camera of that name), kInvalid (its exposures cannot be set; several, of
  ///         a camera whose picture is shown), kUnavailable (the service is still starting)
  Result<void> set_exposures(const std::string& camera, const std::vector<Exposure>& exposures);

 private:
  std::mutex mutex_;
  capture::FrameSource* source_ = nullptr;  // guarded by mutex_
};

}  // namespace penumbra::service
