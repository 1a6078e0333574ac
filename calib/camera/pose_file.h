// Poses of cameras as `calibrate rig` has found them: in the world, or on a body that moves.
// threads: reentrant
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// A rigid transform from its 4 x 4 matrix, column by column.
/// errors: kInvalid (the detail alone: not 16 numbers, not rigid)
Result<Pose> pose_from_matrix(std::span<const double> columns);

/// What the poses of a file refer to: its key `frame`.
enum class PosesIn {
  kWorld,        // "board", or no such key: a file that was written by hand
  kFirstCamera,  // "first camera"
  kTrackedBody,  // "tracked body"
};

struct PoseFile {
  struct NamedPose {
    std::string name;
    Pose pose;  // from the camera into what the poses refer to
  };
  PosesIn poses_in = PosesIn::kWorld;
  std::optional<Seconds> tracker_offset;  // camera time + offset = tracker time
  std::vector<NamedPose> cameras;
};

/// errors: kInvalid (line, key; an unknown frame, a name twice), kUnreadable; `path` names the text
/// in errors
Result<PoseFile> parse_pose_file(std::string_view text, const std::filesystem::path& path);

}  // namespace penumbra::calib
#pragma GCC visibility pop
