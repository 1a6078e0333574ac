// The lenses of 360-degree cameras as cameras of a rig: solved apart, put together again.
// threads: reentrant
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "calib/estimate/rig_calibration.h"
#include "capture/frames.h"
#include "core/pose.h"

namespace penumbra::tools {

/// What a rig's solution calls a camera: one of the capture, or one lens of such a one.
struct RigPart {
  std::size_t camera;               // of the capture
  std::optional<std::size_t> lens;  // of it
  calib::RigCameraInput input;
};

/// "NAME", or "NAME lens 1" and so on.
std::vector<RigPart> parts_of(const capture::CameraInfo& camera, std::size_t index);

/// The picture that a part is of.
FramePixels picture_of(const RigPart& part, const capture::CameraInfo& camera,
                       const FramePixels& whole);

/// A camera put together: its frame is where its first lens is, turned as the capture says.
struct JoinedCamera {
  std::size_t camera;                 // of the capture
  std::size_t first_part;             // which tells its place and how sure that is
  Pose pose;                          // from the camera into what the parts' poses refer to
  std::vector<capture::Lens> lenses;  // as the parts say that they look; empty without
  std::vector<double> apart_m;        // of each lens from the first one
  std::vector<double> turned_rad;     // of each, from what the capture says
};
std::vector<JoinedCamera> join(std::span<const RigPart> parts, std::span<const Pose> poses,
                               const std::vector<capture::CameraInfo>& cameras);

}  // namespace penumbra::tools
