// What the compositor and the reference can draw through.
#pragma once

#include <string>

#include "calib/camera/camera_model.h"
#include "core/result.h"

namespace penumbra::calib {

/// errors: kInvalid (another projection, a distorted one), `where` is given
inline Result<void> check_drawable(const CameraModel& p, const std::string& where) {
  if (p.kind != ProjectionKind::kPinhole)
    return fail(ErrorCode::kInvalid, where, "must be a pinhole camera");
  if (p.is_distorted())
    return fail(ErrorCode::kInvalid, where,
                "a distorted picture cannot be drawn into yet; calibrate it with --undistorted");
  return {};
}

}  // namespace penumbra::calib
