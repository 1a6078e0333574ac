// Private to calib: where an adjustment of a rig begins.
#pragma once

#include <span>
#include <vector>

#include "calib/estimate/rig_calibration.h"

namespace penumbra::calib {

/// The error of a rig that its views do not determine.
std::unexpected<Error> rig_undetermined(std::string detail);

struct RigStart {
  std::vector<RigObservation> views;   // whose board has a pose, by time
  std::vector<std::size_t> moment_of;  // of each view
  std::vector<double> times_s;         // of each moment
  std::vector<Pose> rig_from_camera;
  std::vector<Pose> moments;  // rig from board; with a tracker world from body
  Pose world_from_board;      // with a tracker
  double offset_s = 0;
};

/// errors: as calibrate_rig()
Result<RigStart> start_rig(std::span<const RigCameraInput> cameras,
                           std::span<const RigObservation> observations, const RigOptions& options);

struct TrackerReading {
  Pose pose;
  glm::dvec3 velocity{0}, turning{0};  // metres and radian a second, in the world
  double noise = 1;                    // of the pose, over that of one of the tracker's
  bool known = true;                   // false in a gap, before the first pose and after the last
};
/// What the poses around a time say of it: of a tenth of a second, three at least.
TrackerReading read_tracker(std::span<const TrackerPose> tracker, double time_s);

}  // namespace penumbra::calib
