// Basalt's calibration.json, as several trackers of headsets take it.
#include <fmt/format.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "calib/import/internal/import_fields.h"

namespace penumbra::calib {

namespace {

Result<ForeignLens> read_basalt_lens(const ImportTable& at) {
  PENUMBRA_ASSIGN(type, at.text("camera_type"));
  PENUMBRA_ASSIGN(in, at.table("intrinsics"));
  ForeignLens lens;
  std::vector<std::string_view> terms;
  if (type == "kb4") {
    lens.kind = ProjectionKind::kKannalaBrandt;
    terms = {"k1", "k2", "k3", "k4"};
  } else if (type == "ds") {
    lens.kind = ProjectionKind::kDoubleSphere;
    terms = {"xi", "alpha"};
  } else if (type == "pinhole-radtan8") {
    terms = {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  } else if (type != "pinhole") {
    return at.invalid(
        "camera_type",
        fmt::format("is {}; kb4, ds, pinhole and pinhole-radtan8 can be imported", type));
  }
  for (const std::string_view term : terms) {
    PENUMBRA_ASSIGN(value, in.number(term));
    lens.distortion.push_back(value);
  }
  PENUMBRA_ASSIGN(fx, in.number("fx"));
  PENUMBRA_ASSIGN(fy, in.number("fy"));
  PENUMBRA_ASSIGN(cx, in.number("cx"));
  PENUMBRA_ASSIGN(cy, in.number("cy"));
  lens.fx = fx, lens.fy = fy, lens.cx = cx, lens.cy = cy;
  return lens;
}

Result<CameraModel> read_basalt_camera(const ImportTable& at, double width, double height) {
  PENUMBRA_ASSIGN(lens, read_basalt_lens(at));
  const auto side = [](double v) {
    return v >= 1 && v <= kLargestImportSide ? static_cast<int>(v) : 0;
  };
  lens.width = side(width), lens.height = side(height);
  return make_imported_lens(at, lens);
}

Result<Pose> read_basalt_pose(const ImportTable& at) {
  std::array<double, 7> v{};
  constexpr std::array<std::string_view, 7> kPoseParts = {"px", "py", "pz", "qx", "qy", "qz", "qw"};
  for (std::size_t i = 0; i < v.size(); ++i) {
    PENUMBRA_ASSIGN(value, at.number(kPoseParts[i]));
    v[i] = value;
  }
  const glm::dquat q(v[6], v[3], v[4], v[5]);
  constexpr double kLoose = 1e-2;
  if (!(std::abs(glm::length(q) - 1) < kLoose))
    return at.invalid("qx qy qz qw", "is not of unit length");
  return Pose{glm::normalize(q), {v[0], v[1], v[2]}};
}

}  // namespace

Result<std::optional<ImportedRig>> read_basalt(const ImportTable& root) {
  if (!root.has("value0")) return std::nullopt;
  PENUMBRA_ASSIGN(value, root.table("value0"));
  PENUMBRA_ASSIGN(lenses, value.tables("intrinsics"));
  PENUMBRA_ASSIGN(poses, value.tables("T_imu_cam"));
  PENUMBRA_ASSIGN(sizes, value.numbers("resolution"));
  if (poses.size() != lenses.size() || sizes.size() != 2 * lenses.size())
    return value.invalid("T_imu_cam and resolution", "do not have one entry for each camera");
  std::optional<Seconds> offset;  // added to the frames' times
  if (value.has("cam_time_offset_ns")) {
    PENUMBRA_ASSIGN(ns, value.number("cam_time_offset_ns"));
    offset = Seconds(1e-9 * ns);
  }
  ImportedRig out{"Basalt calibration", "imu", {}};
  for (std::size_t i = 0; i < lenses.size(); ++i) {
    const std::string name = fmt::format("cam{}", i);
    const auto camera = read_basalt_camera(lenses[i], sizes[2 * i], sizes[2 * i + 1]);
    PENUMBRA_ASSIGN(imu_from_camera, read_basalt_pose(poses[i]));
    if (camera)
      out.cameras.push_back({name, "", *camera, with_our_camera(imu_from_camera), offset});
    else
      out.unknown.push_back({name, camera.error()});
  }
  if (out.cameras.empty() && !out.unknown.empty()) return std::unexpected(out.unknown[0].error);
  return out;
}

}  // namespace penumbra::calib
