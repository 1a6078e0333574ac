// Pictures of a camera as it would have seen them after it turned.
// threads: reentrant
#pragma once

#include <cstdint>
#include <glm/gtc/quaternion.hpp>
#include <memory>

#include "calib/camera/camera_model.h"
#include "calib/camera/vignetting.h"
#include "capture/frames.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Radians that a pixel in the middle of the picture sees.
double pixel_angle(const calib::CameraModel& projection);

/// Each pixel takes the nearest one's codes, so that their noise stays theirs; places are far away.
/// `valid` becomes 0 where the picture did not reach, and where the lens dimmed it by 3 % more or
/// less than it dims its new place.
std::shared_ptr<const FramePixels> turned(const FramePixels& picture,
                                          const calib::CameraModel& projection,
                                          const Vignetting& vignetting,
                                          const glm::dquat& before_from_now,
                                          Image<std::uint8_t>& valid);

}  // namespace penumbra::capture
#pragma GCC visibility pop
