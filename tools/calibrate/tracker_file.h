// Poses of a tracker as a table.
#pragma once

#include <filesystem>
#include <vector>

#include "calib/estimate/rig_calibration.h"
#include "core/result.h"

namespace penumbra::tools {

/// CSV with the header time_s,tx,ty,tz,qx,qy,qz,qw: metres, a unit quaternion, times that rise.
/// errors: kNotFound, kUnreadable, kInvalid (file and line)
Result<std::vector<calib::TrackerPose>> read_tracker_file(const std::filesystem::path& path);

}  // namespace penumbra::tools
