// [pose] of rig.toml: where the cameras are, frame by frame (docs/reference/poses.md).
// threads: reentrant
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/track/board_tracker.h"
#include "capture/poses/posed_source.h"
#include "core/result.h"

namespace penumbra {
class TomlKeys;
}

namespace penumbra::service {

struct PoseConfig {
  std::string source;                // "board", "track", "stream" or "openxr"
  std::vector<std::string> cameras;  // that move; empty: those of `calibration`, else all views
  std::optional<std::filesystem::path> calibration;
  std::vector<calib::PlacedBoard> boards;
  std::filesystem::path file, socket;
  std::optional<int> port;
  bool by_arrival = false;
  double clock_offset_s = 0;
  std::string device = "head";  // of "openxr": or "left" or "right", a controller
};

/// path: of rig.toml; names in it are relative to its folder
/// errors: kInvalid (file, line, key)
Result<PoseConfig> read_pose_config(const std::filesystem::path& path, const TomlKeys& keys);

/// The source's frames with the poses of their times.
/// openxr: the head's poses; null where `source` is another one
/// errors: kInvalid (a camera that does not exist; as PosedSource, BoardPoseSource, PoseTrack and
///         PoseStream), kNotFound, kUnreadable, kUnavailable
Result<std::unique_ptr<capture::PosedSource>> with_poses(
    std::unique_ptr<capture::FrameSource> frames, const PoseConfig& config,
    std::unique_ptr<capture::PoseSource> openxr);

}  // namespace penumbra::service
