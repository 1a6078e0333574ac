// The Valve Index's config.json, as Steam keeps it for each headset. Poses are by two axes and a
// position in the frame of the headset's sensors.
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>

#include "calib/import/internal/import_fields.h"

namespace penumbra::calib {

namespace {

Result<Pose> read_axes(const ImportTable& at) {
  PENUMBRA_ASSIGN(x, at.numbers("plus_x", 3));
  PENUMBRA_ASSIGN(z, at.numbers("plus_z", 3));
  PENUMBRA_ASSIGN(p, at.numbers("position", 3));
  const glm::dvec3 right(x[0], x[1], x[2]), back(z[0], z[1], z[2]);
  PENUMBRA_ASSIGN(
      q, rotation_of(at, "plus_x and plus_z", glm::dmat3(right, glm::cross(back, right), back)));
  return Pose{q, {p[0], p[1], p[2]}};
}

// Cameras of a headset look where the face looks. That tells whether a file's z is their view or
// its opposite, which versions of it leave open.
Result<Pose> facing_forward(const ImportTable& at, const Pose& head_from_axes) {
  const double back = (head_from_axes.rotation * glm::dvec3(0, 0, 1)).z;
  constexpr double kForward = .5;  // within 60 degrees
  if (back > kForward) return head_from_axes;
  if (back < -kForward) return with_our_camera(head_from_axes);
  return at.invalid("extrinsics", "has a camera that does not look forward");
}

Result<CameraModel> read_index_lens(const ImportTable& camera) {
  PENUMBRA_ASSIGN(in, camera.table("intrinsics"));
  ForeignLens lens{.kind = ProjectionKind::kKannalaBrandt, .distortion = {}};
  PENUMBRA_ASSIGN(width, in.integer("width", 1, kLargestImportSide));
  PENUMBRA_ASSIGN(height, in.integer("height", 1, kLargestImportSide));
  PENUMBRA_ASSIGN(fx, in.number("focal_x"));
  PENUMBRA_ASSIGN(fy, in.number("focal_y"));
  PENUMBRA_ASSIGN(cx, in.number("center_x"));
  PENUMBRA_ASSIGN(cy, in.number("center_y"));
  PENUMBRA_ASSIGN(distort, in.table("distort"));
  PENUMBRA_ASSIGN(terms, distort.numbers("coeffs", 4));
  lens.width = width, lens.height = height;
  lens.fx = fx, lens.fy = fy, lens.cx = cx, lens.cy = cy;
  lens.distortion = terms;
  return make_imported_lens(in, lens);
}

}  // namespace

Result<std::optional<ImportedRig>> read_valve_index(const ImportTable& root) {
  if (!root.has("tracked_cameras")) return std::nullopt;
  PENUMBRA_ASSIGN(cameras, root.tables("tracked_cameras"));
  PENUMBRA_ASSIGN(head, root.table("head"));
  PENUMBRA_ASSIGN(sensors_from_head, read_axes(head));
  ImportedRig out{"Valve Index config", "head", {}};
  for (const ImportTable& one : cameras) {
    PENUMBRA_ASSIGN(name, one.text("name"));
    PENUMBRA_ASSIGN(lens, read_index_lens(one));
    PENUMBRA_ASSIGN(extrinsics, one.table("extrinsics"));
    PENUMBRA_ASSIGN(sensors_from_camera, read_axes(extrinsics));
    PENUMBRA_ASSIGN(pose, facing_forward(one, sensors_from_head.inverse() * sensors_from_camera));
    out.cameras.push_back({name, name == "left" || name == "right" ? name : "", lens, pose});
  }
  return out;
}

}  // namespace penumbra::calib
