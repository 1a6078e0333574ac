// Poses of a tracker as a table.
#pragma once

#include <filesystem>
#include <vector>

#include "calib/estimate/rig_calibration.h"
#include "core/result.h"

namespace penumbra::tools {

/// A track as capture::read_pose_track() reads it, in seconds.
/// errors: kNotFound, kUnreadable, kInvalid (file and line)
Result<std::vector<calib::TrackerPose>> read_tracker_file(const std::filesystem::path& path);

}  // namespace penumbra::tools
