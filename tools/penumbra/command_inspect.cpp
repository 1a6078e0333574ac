#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <filesystem>

#include "calib/camera/camera_model.h"
#include "capture/device/cameras.h"
#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "capture/recording/recording.h"
#include "codec/codec.h"
#include "core/conventions.h"
#include "core/toml_keys.h"
#include "prt/bake/baked_file.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"
#include "runtime/pipeline/report.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"

namespace penumbra::tools {

namespace {

struct InspectOptions {
  std::string file;
  bool json = false;
};

namespace fs = std::filesystem;
using nlohmann::json;

Result<json> inspect_capture(const std::string& path, const char* kind) {
  auto source = capture::open_capture(path);
  if (!source) return std::unexpected(source.error());
  json cameras = json::array();
  for (const capture::CameraInfo& c : (*source)->cameras())
    cameras.push_back({{"name", c.name},
                       {"role", c.role == capture::Role::kView ? "view" : "environment"},
                       {"width", c.projection.width},
                       {"height", c.projection.height},
                       {"projection", calib::projection_name(c.projection.kind)},
                       {"response", c.response.describe()},
                       {"frames", 0}});
  for (;;) {
    auto frame = (*source)->next();
    if (!frame) return std::unexpected(frame.error());
    if (!*frame) break;
    json& camera = cameras[static_cast<std::size_t>((*frame)->camera)];
    camera["frames"] = camera["frames"].get<int>() + 1;
    if (!camera.contains("first_time_s"))
      camera["first_time_s"] = ((*frame)->time - TimestampNs{0}).count();
    camera["last_time_s"] = ((*frame)->time - TimestampNs{0}).count();
  }
  return json{{"kind", kind}, {"cameras", cameras}};
}

Result<json> inspect_baked(const std::string& file) {
  auto baked = prt::read_baked(file);
  if (!baked) return std::unexpected(baked.error());
  json out = {{"kind", "baked object"},
              {"vertices", baked->mesh.positions.size()},
              {"triangles", baked->mesh.triangles.size()},
              {"bands", baked->transfer.bands},
              {"channels", baked->transfer.channels},
              {"rays", baked->report.rays},
              {"standard_error", baked->report.standard_error}};
  if (baked->receiver) {
    const prt::GroundGrid& g = baked->receiver->grid;
    out["receiver"] = {{"texels", g.size * g.size},
                       {"half_extent_m", g.half_extent},
                       {"height_m", g.height},
                       {"albedo", runtime::to_json(baked->receiver->albedo)}};
  }
  return out;
}

Result<json> inspect_mesh(const std::string& file) {
  auto imported = prt::import_mesh(file, {.7f, .7f, .7f});
  if (!imported) return std::unexpected(imported.error());
  const prt::Bounds b = bounds_of(imported->mesh);
  return json{{"kind", "mesh"},
              {"vertices", imported->mesh.positions.size()},
              {"triangles", imported->mesh.triangles.size()},
              {"degenerate_triangles", imported->degenerate_triangles},
              {"size_m", {b.high.x - b.low.x, b.high.y - b.low.y, b.high.z - b.low.z}},
              {"low_m", {b.low.x, b.low.y, b.low.z}}};
}

Result<json> inspect_picture(const std::string& file) {
  auto frame = codec::read_frame(file);
  if (!frame) return std::unexpected(frame.error());
  json out = {{"width", capture::width(*frame)}, {"height", capture::height(*frame)}};
  const auto* linear = std::get_if<Image<Rgb>>(&*frame);
  if (!linear) {
    out["kind"] = std::holds_alternative<Image<Rgb8>>(*frame) ? "8-bit picture" : "16-bit picture";
    return out;
  }
  double low = HUGE_VAL, high = 0, sum = 0;
  std::size_t finite = 0;
  for (const Rgb& c : linear->pixels()) {
    if (!is_finite(c)) continue;
    const double y = luminance(c);
    if (y > 0) low = std::min(low, y);
    high = std::max(high, y);
    sum += y;
    ++finite;
  }
  out["kind"] = "HDR picture";
  out["non_finite"] = linear->area() - finite;
  out["smallest_positive_luminance"] = std::isfinite(low) ? low : 0;
  out["largest_luminance"] = high;
  out["mean_luminance"] = finite ? sum / static_cast<double>(finite) : 0;
  return out;
}

Result<json> inspect_toml(const std::string& file) {
  auto root = parse_toml(file);
  if (!root) return std::unexpected(root.error());
  if (root->contains("capture")) {
    auto rig = service::read_rig_config(file);
    if (!rig) return std::unexpected(rig.error());
    return json{{"kind", "service configuration"}, {"source", rig->source}, {"bands", rig->bands}};
  }
  if (root->contains("camera")) {
    auto camera = capture::read_camera_file(file);
    if (!camera) return std::unexpected(camera.error());
    return json{{"kind", "camera"},
                {"name", camera->name},
                {"width", camera->projection.width},
                {"height", camera->projection.height},
                {"projection", calib::projection_name(camera->projection.kind)}};
  }
  auto scene = runtime::read_scene(file);
  if (!scene) return std::unexpected(scene.error());
  json objects = json::array();
  for (const runtime::SceneObject& o : scene->objects) {
    json object = {{"name", o.name}, {"asset", o.asset}};
    if (!o.animation.empty()) object["animation"] = o.animation;
    if (!o.blend.empty()) object["blend"] = {{"animation", o.blend}, {"share", o.blend_weight}};
    if (o.live) object["transfer"] = "live";
    if (!o.transfer.empty()) object["transfer"] = o.transfer;
    objects.push_back(object);
  }
  return json{{"kind", "scene"}, {"objects", objects}, {"real", scene->real.size()}};
}

json to_json(const std::optional<capture::ControlRange>& range) {
  return range ? json{range->low, range->high} : json(nullptr);
}

Result<void> inspect_cameras(bool as_json) {
  const capture::CameraList list = capture::list_cameras();
  json cameras = json::array();
  for (const capture::CameraListing& c : list.cameras) {
    json modes = json::array();
    for (const capture::CameraMode& m : c.modes)
      modes.push_back({{"format", m.format},
                       {"width", m.width},
                       {"height", m.height},
                       {"fps", m.max_fps},
                       {"readable", m.readable}});
    cameras.push_back({{"device", c.device},
                       {"name", c.name},
                       {"driver", c.driver},
                       {"exposure_s", to_json(c.exposure_s)},
                       {"gain", to_json(c.gain)},
                       {"modes", modes}});
  }
  json rejected = json::array();
  for (const Error& e : list.rejected)
    rejected.push_back({{"device", e.where}, {"reason", e.detail}});
  if (as_json) {
    print_json({{"kind", "cameras"}, {"cameras", cameras}, {"rejected", rejected}});
    return {};
  }
  for (const capture::CameraListing& c : list.cameras) {
    fmt::print("{}: {} ({})\n", c.device, c.name, c.driver);
    if (c.exposure_s)
      fmt::print("  exposure {:g} to {:g} s\n", c.exposure_s->low, c.exposure_s->high);
    else
      fmt::print("  exposure cannot be set\n");
    if (c.gain) fmt::print("  gain {:g} to {:g} (the driver's unit)\n", c.gain->low, c.gain->high);
    std::string format;
    for (const capture::CameraMode& m : c.modes) {
      if (m.format != format)
        fmt::print("{}  {}{}", format.empty() ? "" : "\n", m.format,
                   m.readable ? "" : " (not read)");
      format = m.format;
      fmt::print(" {}x{}", m.width, m.height);
      if (m.max_fps > 0) fmt::print("@{:g}", m.max_fps);
    }
    if (!c.modes.empty()) fmt::print("\n");
  }
  for (const Error& e : list.rejected) fmt::print("{}: left out, {}\n", e.where, e.detail);
  if (list.cameras.empty()) fmt::print("no camera\n");
  return {};
}

Result<json> describe(const std::string& file) {
  std::error_code error;
  if (fs::is_directory(file, error)) return inspect_capture(file, "capture folder");
  const std::string extension = fs::path(file).extension().string();
  if (extension == ".mkv") return inspect_capture(file, "recording");
  if (extension == ".toml") return inspect_toml(file);
  if (extension == ".glb" && prt::is_baked_file(file)) return inspect_baked(file);
  if (extension == ".shlm") {
    auto clip = prt::read_sequence_info(file);
    if (!clip) return std::unexpected(clip.error());
    return json{{"kind", "baked clip"},
                {"seconds", clip->seconds},
                {"key_frames", clip->key_frames},
                {"light_map", {clip->map_width, clip->map_height}},
                {"receiver_texels", clip->ground_size * clip->ground_size},
                {"standard_error", clip->report.standard_error},
                {"compression_error", clip->report.compression_error},
                {"interpolation_error", clip->report.interpolation_error},
                {"bytes", fs::file_size(file, error)}};
  }
  for (const char* mesh : {".glb", ".gltf", ".obj", ".ply", ".fbx"})
    if (extension == mesh) return inspect_mesh(file);
  return inspect_picture(file);
}

}  // namespace

Result<void> inspect(const InspectOptions& o) {
  if (o.file == "cameras" && !fs::exists(o.file)) return inspect_cameras(o.json);
  auto description = describe(o.file);
  if (!description) return std::unexpected(description.error());
  (*description)["file"] = o.file;
  if (o.json) {
    print_json(*description);
    return {};
  }
  for (const auto& [key, value] : description->items())
    fmt::print("{}: {}\n", key, value.is_string() ? value.get<std::string>() : value.dump());
  return {};
}

void add_inspect(CLI::App& parent, Action& action) {
  static InspectOptions inspect_options;
  auto* c = parent.add_subcommand(
      "inspect",
      "What is in a file: picture, mesh, baked object, scene, camera, capture "
      "folder, recording; or which cameras there are");
  c->add_option("file", inspect_options.file,
                "File, recording or capture folder; cameras: what stands here and what each can do")
      ->required();
  add_json(c, inspect_options.json);
  c->callback([&] { action = [] { return inspect(inspect_options); }; });
}

}  // namespace penumbra::tools
