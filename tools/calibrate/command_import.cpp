#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/import/import_camera.h"
#include "core/io/files.h"
#include "core/io/toml_keys.h"
#include "runtime/pipeline/report.h"
#include "tools/calibrate/commands.h"
#include "tools/common/command.h"
#include "tools/common/print.h"

namespace penumbra::tools {

namespace {

struct ImportOptions {
  std::string file;
  std::optional<std::string> camera;
  std::string output;
  std::optional<std::string> pose;
  bool json = false;
};

Result<calib::ImportedCamera> choose_camera(const ImportOptions& o, const calib::ImportedRig& rig) {
  std::string names;
  for (const calib::ImportedCamera& one : rig.cameras) {
    if (o.camera ? one.name == *o.camera : rig.cameras.size() == 1) return one;
    names += (names.empty() ? "" : ", ") + one.name;
  }
  return fail(o.camera ? ErrorCode::kNotFound : ErrorCode::kInvalid, o.file,
              o.camera ? fmt::format("has no camera {}; it has {}", *o.camera, names)
                       : fmt::format("has several cameras: choose one of {} by --camera", names));
}

std::string pair(const glm::dvec2& v) {
  return fmt::format("[{}, {}]", v.x, v.y);
}

// As calibrate camera writes it, without what tells how sure it is.
std::string print_imported_camera(const calib::ImportedCamera& c) {
  const calib::CameraModel& p = c.camera;
  const bool pinhole = p.kind == calib::ProjectionKind::kPinhole;
  std::string text = fmt::format(
      "version = 1\n\n[[camera]]\nname = {}\nrole = \"{}\"\nwidth = {}\nheight = {}\n"
      "projection = \"{}\"\nfocal_px = {}\nprincipal_px = {}\n",
      toml_quoted(c.name), pinhole ? "view" : "environment", p.width, p.height,
      calib::projection_name(p.kind), pair(p.focal_px), pair(p.principal_px));
  if (p.is_distorted())
    text += fmt::format("distortion = [{}]\n",
                        fmt::join(p.distortion.begin(),
                                  p.distortion.begin() + calib::distortion_count(p.kind), ", "));
  return text;
}

// As calibrate rig writes it. A head or an IMU is a body that a tracker follows.
std::string print_imported_poses(const calib::ImportedRig& rig) {
  std::string text = fmt::format("version = 1\n\n[rig]\nframe = \"{}\"  # the {}\n",
                                 rig.body == "first camera" ? rig.body : "tracked body", rig.body);
  for (const calib::ImportedCamera& one : rig.cameras) {
    if (!one.body_from_camera) continue;
    const glm::dmat4 m = one.body_from_camera->matrix();
    text += fmt::format("\n[[camera]]\nname = {}\nworld_from_camera = [{}]\n",
                        toml_quoted(one.name), fmt::join(&m[0][0], &m[0][0] + 16, ", "));
  }
  return text;
}

nlohmann::json to_json(const calib::ImportedRig& rig, const calib::ImportedCamera& c) {
  const calib::CameraModel& p = c.camera;
  return {
      {"format", rig.format},
      {"name", c.name},
      {"projection", calib::projection_name(p.kind)},
      {"width", p.width},
      {"height", p.height},
      {"focal_px", {p.focal_px.x, p.focal_px.y}},
      {"principal_px", {p.principal_px.x, p.principal_px.y}},
      {"distortion", std::vector<double>(p.distortion.begin(),
                                         p.distortion.begin() + calib::distortion_count(p.kind))},
      {"body", rig.body}};
}

}  // namespace

Result<void> calibrate_import(const ImportOptions& o) {
  PENUMBRA_TRY(check_writable(o.output));
  if (o.pose) PENUMBRA_TRY(check_writable(*o.pose));
  PENUMBRA_ASSIGN(rig, calib::import_camera(o.file));
  PENUMBRA_ASSIGN(camera, choose_camera(o, rig));
  if (o.pose && rig.body.empty())
    return fail(ErrorCode::kInvalid, o.file, "does not tell where its cameras are");
  PENUMBRA_TRY(write_bytes(o.output, print_imported_camera(camera)));
  if (o.pose) PENUMBRA_TRY(write_bytes(*o.pose, print_imported_poses(rig)));
  const calib::CameraModel& p = camera.camera;
  if (o.json)
    print_json(to_json(rig, camera));
  else
    fmt::print("{}: {} of a {}: {} of {}x{} pixels\n", o.output, camera.name, rig.format,
               calib::projection_name(p.kind), p.width, p.height);
  return {};
}

void add_calibrate_import(CLI::App& parent, Action& action) {
  static ImportOptions import;
  auto* c = parent.add_subcommand(
      "import",
      "Make a camera file from a calibration of the Valve Index, Kalibr, Basalt, OpenCV or ROS");
  c->add_option("file", import.file,
                "Index's config.json, Kalibr's camchain.yaml, Basalt's calibration.json, OpenCV's "
                "YAML, XML or JSON, or a camera_info of ROS")
      ->required();
  c->add_option("--camera", import.camera, "Name of the camera in a file that has several");
  c->add_option("-o,--output,--out", import.output, "Camera file to write, .toml")->required();
  c->add_option("--pose", import.pose,
                "Also a pose file to write, .toml: all cameras of the file in the frame of the "
                "head, of the IMU or of the first camera");
  add_json(c, import.json);
  c->callback([&] { action = [] { return calibrate_import(import); }; });
}

}  // namespace penumbra::tools
