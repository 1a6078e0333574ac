// What the compositor and the reference can draw through.
// threads: reentrant
#pragma once

#include <string>

#include "calib/camera/camera_model.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// errors: kInvalid (another projection, a distorted one), `where` is given
inline Result<void> check_drawable(const CameraModel& p, const std::string& where) {
  if (p.kind != ProjectionKind::kPinhole)
    return fail(ErrorCode::kInvalid, where,
                "is not a pinhole camera, and objects are drawn into pinhole pictures only");
  if (p.is_distorted())
    return fail(ErrorCode::kInvalid, where,
                "has distortion, and objects are drawn into undistorted pictures only: calibrate "
                "it with --undistorted");
  return {};
}

}  // namespace penumbra::calib
#pragma GCC visibility pop
