#include "service/http/camera_control.h"

#include <algorithm>

namespace penumbra::service {

void CameraControl::attach(capture::FrameSource* source) {
  const std::scoped_lock lock(mutex_);
  source_ = source;
}

Result<void> CameraControl::set_exposures(const std::string& camera,
                                          const std::vector<Exposure>& exposures) {
  const std::scoped_lock lock(mutex_);
  if (!source_) return fail(ErrorCode::kUnavailable, "the service", "is still starting");
  const std::vector<capture::CameraInfo>& cameras = source_->cameras();
  const auto found = std::ranges::find(cameras, camera, &capture::CameraInfo::name);
  if (found == cameras.end()) return fail(ErrorCode::kNotFound, camera, "is no camera of this rig");
  if (found->role == capture::Role::kView && exposures.size() > 1)
    return fail(ErrorCode::kInvalid, "exposures_s",
                "are several, of a camera whose picture is shown: it takes one");
  return source_->set_exposures(static_cast<int>(found - cameras.begin()), exposures);
}

}  // namespace penumbra::service
