#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <algorithm>
#include <cctype>
#include <filesystem>

#include "calib/camera/calibration_files.h"
#include "calib/camera/camera_model.h"
#include "calib/camera/response.h"
#include "calib/camera/vignetting.h"
#include "calib/import/camera_presets.h"
#include "capture/device/cameras.h"
#include "capture/device/rig.h"
#include "capture/frames.h"
#include "capture/recording/folder.h"
#include "capture/recording/folder_format.h"
#include "capture/recording/undamaged_frames.h"
#include "codec/codec.h"
#include "codec/gain_map_jpeg.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "core/io/toml_keys.h"
#include "prt/bake/baked_file.h"
#include "prt/clip/sequence.h"
#include "prt/geometry/receiver.h"
#include "runtime/pipeline/report.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"
#include "tools/common/command.h"
#include "tools/common/print.h"
#include "tools/penumbra/commands.h"
#include "tools/penumbra/inspect_mesh.h"
#include "tools/penumbra/inspect_report.h"
#include "tools/penumbra/memory_report.h"

namespace penumbra::tools {

namespace {

struct InspectOptions {
  std::string file;
  bool json = false;
};

namespace fs = std::filesystem;
using nlohmann::json;

json to_json(const capture::CameraInfo& c) {
  return {{"name", c.name},
          {"role", c.gives_maps ? "light track" : capture::role_name(c.role)},
          {"width", c.projection.width},
          {"height", c.projection.height},
          {"projection", calib::projection_name(c.projection.kind)}};
}

Result<json> inspect_capture(const std::string& path, const char* kind) {
  PENUMBRA_ASSIGN(source, capture::UndamagedFrames::open(path, capture::RecordedLight::kBoth));
  json cameras = json::array();
  for (const capture::CameraInfo& c : source->cameras()) {
    json& camera = cameras.emplace_back(to_json(c));
    if (capture::sees_light(c.role)) camera["response"] = c.response.describe();
    camera["frames"] = 0;
  }
  for (;;) {
    PENUMBRA_ASSIGN(frame, source->next());
    if (!frame) break;
    json& camera = cameras[static_cast<std::size_t>(frame->camera)];
    camera["frames"] = camera["frames"].get<int>() + 1;
    if (!camera.contains("first_time_s"))
      camera["first_time_s"] = (frame->time - TimestampNs{0}).count();
    camera["last_time_s"] = (frame->time - TimestampNs{0}).count();
  }
  return json{{"kind", kind}, {"cameras", cameras}, {"damaged_frames", source->left_out()}};
}

Result<json> inspect_baked(const std::string& file) {
  PENUMBRA_ASSIGN(baked, prt::read_baked(file));
  json out = {{"kind", "baked object"},
              {"vertices", baked.mesh.positions.size()},
              {"triangles", baked.mesh.triangles.size()},
              {"bands", baked.transfer.bands},
              {"channels", baked.transfer.channels},
              {"rays", baked.report.rays},
              {"standard_error", baked.report.standard_error},
              {"memory", report_memory(baked)}};
  if (baked.receiver) {
    const prt::GroundGrid& g = baked.receiver->grid;
    out["receiver"] = {
        {"texels", g.size * g.size},
        {"half_extent_m", g.half_extent},
        {"height_m", g.height},
        {"albedo", baked.floor.points > 0 ? json() : runtime::to_json(baked.receiver->albedo)}};
  }
  return out;
}

Result<json> inspect_picture(const std::string& file) {
  PENUMBRA_ASSIGN(frame, codec::read_picture(file));
  json out = {{"width", capture::width(frame)}, {"height", capture::height(frame)}};
  const auto* linear = std::get_if<Image<Rgb>>(&frame);
  if (!linear) {
    out["kind"] = std::holds_alternative<Image<Rgb8>>(frame) ? "8-bit picture" : "16-bit picture";
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

Result<json> inspect_camera(const std::string& file, const toml::table& root) {
  PENUMBRA_ASSIGN(camera, capture::read_camera_file(file));
  const calib::CameraModel& p = camera.projection;
  json out = to_json(camera);
  out["kind"] = "camera";
  if (calib::has_intrinsics(p.kind)) {
    out["focal_px"] = {p.focal_px.x, p.focal_px.y};
    out["principal_px"] = {p.principal_px.x, p.principal_px.y};
    out["distortion"] = std::vector<double>(p.distortion.begin(),
                                            p.distortion.begin() + calib::distortion_count(p.kind));
  }
  if (const auto rms = root["calibration"]["rms_px"].value<double>()) out["rms_px"] = *rms;
  return out;
}

// What `read` makes of the text of a file.
template <class Value>
Result<Value> parse_with(Result<Value> (*read)(std::string_view, const fs::path&),
                         const std::string& file) {
  PENUMBRA_ASSIGN(bytes, read_bytes(file));
  return read({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, file);
}

Result<json> inspect_response(const std::string& file) {
  PENUMBRA_ASSIGN(response, parse_with(&calib::parse_response_file, file));
  return json{{"kind", "response"},
              {"response", response.describe()},
              {"channels", response.same_for_all_channels() ? 1 : 3},
              {"light_at_half_code",
               {response.decode(.5, 0), response.decode(.5, 1), response.decode(.5, 2)}}};
}

Result<json> inspect_noise(const std::string& file) {
  PENUMBRA_ASSIGN(noise, parse_with(&calib::parse_noise_file, file));
  return json{{"kind", "noise"},
              {"full_well_electrons", noise.model.full_well_electrons},
              {"read_noise", noise.model.read_noise},
              {"black_level", noise.black_level}};
}

Result<json> inspect_vignetting(const std::string& file) {
  PENUMBRA_ASSIGN(terms, parse_with(&calib::parse_vignetting_file, file));
  Vignetting lens;
  lens.terms = terms;
  return json{{"kind", "vignetting"}, {"terms", terms}, {"corner", lens.at_squared(1)}};
}

Result<json> inspect_colour(const std::string& file, const toml::table& root) {
  PENUMBRA_ASSIGN(m, parse_with(&calib::parse_colour_file, file));
  json out = {{"kind", "colour"}, {"matrix", json::array()}};
  for (int r = 0; r < 3; ++r) out["matrix"].push_back({m[0][r], m[1][r], m[2][r]});
  if (const auto rms = root["colour"]["rms"].value<double>()) out["rms"] = *rms;
  return out;
}

Result<json> inspect_poses(const std::string& file, const toml::table& root) {
  const fs::path path(file);
  const TomlKeys keys(path, root);
  PENUMBRA_TRY(keys.version(1));
  PENUMBRA_ASSIGN(tables, keys.tables("camera"));
  json cameras = json::array();
  for (const toml::table* table : tables) {
    const TomlKeys camera(path, *table);
    PENUMBRA_ASSIGN(name, camera.text("name"));
    PENUMBRA_ASSIGN(m, camera.numbers("world_from_camera", 16));
    cameras.push_back({{"name", name}, {"position_m", {m[12], m[13], m[14]}}});
  }
  json out = {{"kind", "poses"}, {"cameras", cameras}};
  if (const auto frame = root["rig"]["frame"].value<std::string>()) out["frame"] = *frame;
  if (const auto rms = root["rig"]["rms_px"].value<double>()) out["rms_px"] = *rms;
  return out;
}

// Also one without [capture], as calibrate ball takes it.
Result<json> inspect_rig(const std::string& file, const toml::table& root) {
  json out = {{"kind", "rig"}, {"cameras", json::array()}, {"scene", nullptr}};
  std::vector<capture::RigCamera> cameras;
  if (root.contains("capture")) {
    PENUMBRA_ASSIGN(rig, service::read_rig_config(file, false));
    out["source"] = rig.source;
    out["bands"] = rig.bands;
    out["max_lights"] = rig.max_lights;
    cameras = std::move(rig.cameras);
  } else {
    PENUMBRA_ASSIGN(found, capture::read_rig_cameras(file));
    cameras = std::move(found);
  }
  if (const auto scene = root["scene"]["file"].value<std::string>()) out["scene"] = *scene;
  for (const capture::RigCamera& c : cameras) {
    json& camera = out["cameras"].emplace_back(to_json(c.info));
    camera["device"] = c.settings.device;
    if (c.half) camera["half"] = *c.half == capture::StereoHalf::kLeft ? "left" : "right";
    camera["exposures_s"] = json::array();
    for (const Exposure& e : c.schedule) camera["exposures_s"].push_back(e.time.count());
    if (c.light_error) camera["exposures_s"] = "auto";
  }
  return out;
}

Result<json> inspect_scene(const std::string& file) {
  PENUMBRA_ASSIGN(scene, runtime::read_scene(file));
  json objects = json::array();
  for (const runtime::SceneObject& o : scene.objects) {
    json object = {{"name", o.name}, {"asset", o.asset}};
    if (!o.animation.empty()) object["animation"] = o.animation;
    if (!o.blend.empty()) object["blend"] = {{"animation", o.blend}, {"weight", o.blend_weight}};
    if (o.live) object["transfer"] = "live";
    if (!o.transfer.empty()) object["transfer"] = o.transfer;
    objects.push_back(object);
  }
  return json{{"kind", "scene"}, {"objects", objects}, {"real", scene.real.size()}};
}

bool any_camera_has(const toml::table& root, std::initializer_list<std::string_view> keys) {
  const toml::array* const cameras = root["camera"].as_array();
  if (!cameras) return false;
  for (const toml::node& camera : *cameras)
    for (const std::string_view key : keys)
      if (camera.is_table() && camera.as_table()->contains(key)) return true;
  return false;
}

// By the tables and keys that only one kind has; the kind's reader then tells what is wrong.
Result<json> inspect_toml(const std::string& file) {
  PENUMBRA_ASSIGN(root, parse_toml(file));
  const auto has = [&](std::string_view key) { return root.contains(key); };
  if (has("capture") || any_camera_has(root, {"device"})) return inspect_rig(file, root);
  if (fs::path(file).filename() == capture::kManifestName)
    return inspect_capture(fs::absolute(file).parent_path().string(), "capture folder");
  if (has("rig") || (any_camera_has(root, {"world_from_camera"}) &&
                     !any_camera_has(root, {"projection", "intrinsics", "lens"})))
    return inspect_poses(file, root);
  if (has("camera")) return inspect_camera(file, root);
  if (has("decode")) return inspect_response(file);
  if (has("noise")) return inspect_noise(file);
  if (has("vignetting")) return inspect_vignetting(file);
  if (has("colour")) return inspect_colour(file, root);
  const bool empty_scene = root.size() == 1 && has("version");
  if (has("object") || has("real") || has("lamp") || empty_scene) return inspect_scene(file);
  return fail(ErrorCode::kInvalid, file,
              "is none of the TOML files that inspect understands: scene, rig, capture.toml, and "
              "the calibrations camera, response, noise, vignetting, colour and poses");
}

json to_json(const std::optional<capture::ControlRange>& range) {
  return range ? json{range->low, range->high} : json(nullptr);
}

json to_json(const std::optional<calib::CameraPreset>& preset) {
  if (!preset) return nullptr;
  return {{"headset", preset->headset},
          {"width", preset->width},
          {"height", preset->height},
          {"format", preset->pixel_format},
          {"fps", preset->rate_hz},
          {"side_by_side", preset->side_by_side},
          {"calibration", preset->calibration}};
}

// Other cameras have the same name: those of a headset have its frames, too.
std::optional<calib::CameraPreset> preset_of(const capture::CameraListing& camera) {
  const auto preset = calib::find_camera_preset(camera.name);
  const bool has_frames =
      preset && std::ranges::any_of(camera.modes, [&](const capture::CameraMode& m) {
        return m.format == preset->pixel_format && m.width == preset->width &&
               m.height == preset->height;
      });
  return has_frames ? preset : std::nullopt;
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
                       {"passes_through", to_json(preset_of(c))},
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
    if (const auto preset = preset_of(c)) fmt::print("{}", calib::advice(*preset));
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
  const std::string extension = lower_extension(file);
  const auto is_one_of = [&](std::initializer_list<std::string_view> kinds) {
    return std::ranges::find(kinds, extension) != kinds.end();
  };
  if (extension == ".mkv") return inspect_capture(file, "recording");
  if (extension == ".toml") return inspect_toml(file);
  if (extension == ".glb" && prt::is_baked_file(file)) return inspect_baked(file);
  if (extension == ".shlm") {
    PENUMBRA_ASSIGN(clip, prt::read_sequence_info(file));
    return json{{"kind", "baked clip"},
                {"seconds", clip.seconds},
                {"key_frames", clip.key_frames},
                {"light_map", {clip.map_width, clip.map_height}},
                {"receiver_texels", clip.ground_size * clip.ground_size},
                {"standard_error", clip.report.standard_error},
                {"compression_error", clip.report.compression_error},
                {"interpolation_error", clip.report.interpolation_error},
                {"bytes", fs::file_size(file, error)}};
  }
  if (is_one_of({".gltf", ".glb", ".obj", ".ply", ".stl", ".fbx", ".dae"}))
    return inspect_mesh(file);
  if (extension == ".csv") return inspect_table(file);
  if (extension == ".svg") return inspect_plot(file);
  if (extension == ".pdf") return inspect_page(file);
  auto picture = inspect_picture(file);  // whatever its name
  const bool named_so =
      is_one_of({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".hdr", ".jph", ".jp2", ".pnr"});
  if (picture || named_so || picture.error().code == ErrorCode::kNotFound) return picture;
  return fail(ErrorCode::kUnreadable, file,
              "is nothing that inspect understands: a picture (PNG, JPEG, TIFF, OpenEXR, Radiance "
              "HDR), a mesh (glTF, OBJ, PLY, STL, FBX, COLLADA), a baked object or clip, a "
              "recording, a capture folder, a TOML file, or a table, plot or board of calibrate");
}

std::string text_of(const json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_array()) return value.dump();
  std::string out;
  for (const json& v : value) out += (out.empty() ? "" : " ") + text_of(v);
  return out.empty() ? "none" : out;
}

// One line a value; what has parts of its own stands below its name, each of a list behind a dash.
void print_lines(const json& object, std::size_t indent) {
  std::string before(indent, ' ');
  if (indent > 0) before.replace(indent - 2, 2, "- ");
  for (const auto& [key, value] : object.items()) {
    const bool list = value.is_array() && !value.empty() && value[0].is_object();
    if (!list && !value.is_object()) {
      fmt::print("{}{}: {}\n", before, key, text_of(value));
    } else {
      fmt::print("{}{}:\n", before, key);
      for (const json& part : list ? value : json::array({value})) print_lines(part, indent + 4);
    }
    before.assign(indent, ' ');
  }
}

}  // namespace

Result<void> inspect(const InspectOptions& o) {
  if (o.file == "cameras" && !fs::exists(o.file)) return inspect_cameras(o.json);
  PENUMBRA_ASSIGN(description, describe(o.file));
  (description)["file"] = o.file;
  if (o.json) {
    print_json(description);
    return {};
  }
  print_lines(description, 0);
  return {};
}

void add_inspect(CLI::App& parent, Action& action) {
  static InspectOptions inspect_options;
  auto* c = parent.add_subcommand(
      "inspect",
      "Say what is in a file, a recording or a capture folder, or which cameras are connected");
  c->add_option(
       "file", inspect_options.file,
       "Picture, mesh, baked object or clip, scene, rig, calibration file, table, plot, board, "
       "recording or capture folder; cameras: list the connected cameras and their modes")
      ->required();
  add_json(c, inspect_options.json);
  c->callback([&] { action = [] { return inspect(inspect_options); }; });
}

}  // namespace penumbra::tools
