#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <array>
#include <chrono>
#include <glm/geometric.hpp>
#include <optional>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/import/import_camera.h"
#include "core/io/files.h"
#include "core/io/log.h"
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
  std::optional<std::string> pose, unit;
  bool json = false;
};

Result<calib::ImportedCamera> choose_camera(const ImportOptions& o, const calib::ImportedRig& rig) {
  std::string names;
  for (const calib::ImportedCamera& one : rig.cameras) {
    if (o.camera ? one.name == *o.camera : rig.cameras.size() + rig.unknown.size() == 1) return one;
    names += (names.empty() ? "" : ", ") + one.name;
  }
  for (const calib::UnknownCamera& one : rig.unknown) {
    if (o.camera && one.name == *o.camera) return std::unexpected(one.error);
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

// Of all cameras: a pose file has one clock. Nothing where the file tells none.
std::optional<Seconds> clock_offset_of(const calib::ImportedRig& rig) {
  Seconds sum(0);
  int count = 0;
  for (const calib::ImportedCamera& one : rig.cameras)
    if (one.clock_offset && one.body_from_camera) sum += *one.clock_offset, ++count;
  if (count == 0) return std::nullopt;
  return sum / count;
}

void tell_what_is_taken(const ImportOptions& o, const calib::ImportedRig& rig) {
  constexpr Seconds kOneClock(.001);
  for (const std::string& note : rig.notes) log_warning("{}: {}", o.file, note);
  for (const calib::UnknownCamera& one : rig.unknown)
    log_warning("{}: {} is left out: {} {}", o.file, one.name, one.error.where, one.error.detail);
  const auto mean = clock_offset_of(rig);
  for (const calib::ImportedCamera& one : rig.cameras)
    if (mean && one.clock_offset && std::chrono::abs(*one.clock_offset - *mean) > kOneClock)
      log_warning("{}: the clock of {} is off the mean of all, which is taken, by {:.1f} ms",
                  o.file, one.name, 1000 * (*one.clock_offset - *mean).count());
}

// OpenCV's places are in the unit in which the board was told.
Result<void> apply_unit(const ImportOptions& o, calib::ImportedRig& rig) {
  constexpr double kFar_m = 2;
  double farthest = 0;
  for (calib::ImportedCamera& one : rig.cameras) {
    if (!one.body_from_camera) continue;
    if (o.unit == "mm") one.body_from_camera->translation /= 1000;
    farthest = std::max(farthest, glm::length(one.body_from_camera->translation));
  }
  if (o.pose && !o.unit && rig.format.starts_with("OpenCV") && farthest > kFar_m)
    return fail(ErrorCode::kInvalid, o.file,
                fmt::format("has its cameras {:.4g} apart, which is far in metres: say --unit mm, "
                            "or --unit m",
                            farthest));
  return {};
}

// As calibrate rig writes it. A head or an IMU is a body that a tracker follows.
std::string print_imported_poses(const calib::ImportedRig& rig) {
  std::string text = fmt::format("version = 1\n\n[rig]\nframe = \"{}\"  # the {}\n",
                                 rig.body == "first camera" ? rig.body : "tracked body", rig.body);
  if (const auto offset = clock_offset_of(rig))
    text += fmt::format("tracker_offset_s = {:.6f}  # camera time + offset = tracker time\n",
                        offset->count());
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
  PENUMBRA_TRY(apply_unit(o, rig));
  if (o.pose && rig.body.empty())
    return fail(ErrorCode::kInvalid, o.file, "does not tell where its cameras are");
  tell_what_is_taken(o, rig);
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
  c->add_option("--unit", import.unit,
                "Unit of the places in the file, m or mm; by default metres, and OpenCV's are "
                "asked for where those would be far apart")
      ->check(CLI::IsMember({"m", "mm"}));
  add_json(c, import.json);
  c->callback([&] { action = [] { return calibrate_import(import); }; });
}

}  // namespace penumbra::tools
