#include "calib/camera/pose_file.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "core/io/toml_keys.h"

namespace penumbra::calib {

namespace {

Result<void> read_rig_table(const TomlKeys& rig, PoseFile& out) {
  if (rig.has("frame")) {
    PENUMBRA_ASSIGN(frame, rig.text("frame"));
    if (frame == "first camera")
      out.poses_in = PosesIn::kFirstCamera;
    else if (frame == "tracked body")
      out.poses_in = PosesIn::kTrackedBody;
    else if (frame != "board")
      return rig.invalid("frame", fmt::format("\"{}\" is none of first camera, board and tracked "
                                              "body",
                                              frame));
  }
  if (rig.has("tracker_offset_s")) {
    constexpr double kLargest_s = 3600;
    PENUMBRA_ASSIGN(seconds, rig.number("tracker_offset_s"));
    if (std::abs(seconds) > kLargest_s) return rig.invalid("tracker_offset_s", "is beyond an hour");
    out.tracker_offset = Seconds(seconds);
  }
  return {};
}

}  // namespace

Result<Pose> pose_from_matrix(std::span<const double> m) {
  constexpr double kTolerance = 1e-3;
  const auto invalid = [](const char* why) { return fail(ErrorCode::kInvalid, "pose", why); };
  if (m.size() != 16) return invalid("does not have 16 numbers");
  if (m[3] != 0 || m[7] != 0 || m[11] != 0 || m[15] != 1)
    return invalid("the last row is not 0 0 0 1 (the list is column-major)");
  const glm::dmat3 r(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      if (!(std::abs(glm::dot(r[a], r[b]) - (a == b ? 1 : 0)) <= kTolerance))
        return invalid("is not a rigid transform: its axes are not orthonormal");
  if (glm::determinant(r) < 0) return invalid("is not a rigid transform: it mirrors");
  return Pose{glm::normalize(glm::quat_cast(r)), {m[12], m[13], m[14]}};
}

Result<PoseFile> parse_pose_file(std::string_view text, const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml_text(text, path));
  const TomlKeys keys(path, root);
  PENUMBRA_TRY(keys.version(1));
  PoseFile out;
  if (keys.has("rig")) {
    PENUMBRA_ASSIGN(rig, keys.table("rig"));
    PENUMBRA_TRY(read_rig_table(rig, out));
  }
  PENUMBRA_ASSIGN(tables, keys.tables("camera"));
  for (const toml::table* table : tables) {
    const TomlKeys camera(path, *table);
    PENUMBRA_ASSIGN(name, camera.text("name"));
    if (std::ranges::find(out.cameras, name, &PoseFile::NamedPose::name) != out.cameras.end())
      return camera.invalid("name", fmt::format("\"{}\" is there twice", name));
    PENUMBRA_ASSIGN(matrix, camera.numbers("world_from_camera", 16));
    const auto pose = pose_from_matrix(matrix);
    if (!pose) return camera.invalid("world_from_camera", pose.error().detail);
    out.cameras.push_back({name, *pose});
  }
  return out;
}

}  // namespace penumbra::calib
