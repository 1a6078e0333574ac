#include "tools/calibrate/tracker_file.h"

#include "capture/poses/pose_track.h"

namespace penumbra::tools {

Result<std::vector<calib::TrackerPose>> read_tracker_file(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(track, capture::read_pose_track(path));
  std::vector<calib::TrackerPose> out;
  out.reserve(track.size());
  for (const capture::TimedPose& pose : track)
    out.push_back({(pose.time - TimestampNs{}).count(), pose.world_from_body});
  return out;
}

}  // namespace penumbra::tools
