// Kalibr's camchain.yaml: cam0, cam1 and so on, each with the transform from the one before, or
// from the IMU.
#include <fmt/format.h>

#include "calib/import/internal/import_fields.h"

namespace penumbra::calib {

namespace {

Result<ForeignLens> read_kalibr_intrinsics(const ImportTable& at) {
  PENUMBRA_ASSIGN(model, at.text("camera_model"));
  ForeignLens lens;
  if (model == "ds") {
    PENUMBRA_ASSIGN(v, at.numbers("intrinsics", 6));
    lens.kind = ProjectionKind::kDoubleSphere;
    lens.distortion = {v[0], v[1]};
    lens.fx = v[2], lens.fy = v[3], lens.cx = v[4], lens.cy = v[5];
    return lens;
  }
  if (model != "pinhole")
    return at.invalid("camera_model", fmt::format("is {}; pinhole and ds can be imported", model));
  PENUMBRA_ASSIGN(v, at.numbers("intrinsics", 4));
  lens.fx = v[0], lens.fy = v[1], lens.cx = v[2], lens.cy = v[3];
  PENUMBRA_ASSIGN(distortion, at.text("distortion_model"));
  if (distortion == "equidistant")
    lens.kind = ProjectionKind::kKannalaBrandt;
  else if (distortion != "radtan" && distortion != "none")
    return at.invalid(
        "distortion_model",
        fmt::format("is {}; radtan, equidistant and none can be imported", distortion));
  if (distortion != "none") {
    PENUMBRA_ASSIGN(terms, at.numbers("distortion_coeffs", 4));
    lens.distortion = terms;
  }
  return lens;
}

Result<CameraModel> read_kalibr_camera(const ImportTable& at) {
  PENUMBRA_ASSIGN(lens, read_kalibr_intrinsics(at));
  PENUMBRA_ASSIGN(size, at.numbers("resolution", 2));
  const auto side = [](double v) {
    return v >= 1 && v <= kLargestImportSide ? static_cast<int>(v) : 0;
  };
  lens.width = side(size[0]), lens.height = side(size[1]);
  return make_imported_lens(at, lens);
}

}  // namespace

Result<std::optional<ImportedRig>> read_kalibr(const ImportTable& root) {
  if (!root.has("cam0")) return std::nullopt;
  ImportedRig out{"Kalibr camchain", "", {}};
  PENUMBRA_ASSIGN(first, root.table("cam0"));
  const bool by_imu = first.has("T_cam_imu");
  Pose first_from_camera;
  constexpr int kMost = 16;
  for (int i = 0; i < kMost && root.has(fmt::format("cam{}", i)); ++i) {
    const std::string name = fmt::format("cam{}", i);
    PENUMBRA_ASSIGN(at, root.table(name));
    const auto camera = read_kalibr_camera(at);
    ImportedCamera one{name, "", {}, std::nullopt};
    if (at.has("timeshift_cam_imu")) {
      PENUMBRA_ASSIGN(shift, at.number("timeshift_cam_imu"));
      one.clock_offset = Seconds(shift);
    }
    if (by_imu) {
      PENUMBRA_ASSIGN(camera_from_imu, at.transform("T_cam_imu"));
      one.body_from_camera = with_our_camera(camera_from_imu.inverse());
      out.body = "imu";
    } else if (i > 0) {
      PENUMBRA_ASSIGN(camera_from_last, at.transform("T_cn_cnm1"));
      first_from_camera = first_from_camera * camera_from_last.inverse();
      one.body_from_camera = between_our_cameras(first_from_camera);
      out.body = "first camera";
    }
    if (camera)
      one.camera = *camera, out.cameras.push_back(std::move(one));
    else
      out.unknown.push_back({name, camera.error()});
  }
  if (out.cameras.empty()) return std::unexpected(out.unknown[0].error);
  if (out.body == "first camera" && out.cameras[0].name == "cam0")
    out.cameras[0].body_from_camera = Pose{};
  return out;
}

}  // namespace penumbra::calib
