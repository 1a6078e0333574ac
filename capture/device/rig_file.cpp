#include <fmt/format.h>

#include <algorithm>

#include "capture/device/rig.h"
#include "capture/recording/camera_table.h"
#include "core/io/toml_keys.h"

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kDeviceKeys[] = {
    "device",    "format",       "fps",         "exposures_s",     "gains",
    "unit_gain", "delay_frames", "light_error", "white_balance_k", "half"};

Result<std::vector<Exposure>> read_schedule(const TomlKeys& keys) {
  if (!keys.has("exposures_s")) return std::vector<Exposure>();
  PENUMBRA_ASSIGN(times, keys.numbers("exposures_s"));
  std::vector<double> gains;
  if (keys.has("gains")) {
    PENUMBRA_ASSIGN(given, keys.numbers("gains", times.size()));
    gains = given;
  }
  auto schedule = exposures_of(times, gains);
  if (!schedule) return keys.invalid(schedule.error().where.c_str(), schedule.error().detail);
  return schedule;
}

// A schedule, or "auto" and what it has to reach.
Result<void> read_exposures(const TomlKeys& keys, RigCamera& camera) {
  const bool automatic = keys.text("exposures_s").value_or("") == "auto";
  if (!automatic) {
    if (keys.has("light_error")) return keys.invalid("light_error", "needs exposures_s = \"auto\"");
    PENUMBRA_ASSIGN(schedule, read_schedule(keys));
    camera.schedule = std::move(schedule);
    return {};
  }
  if (keys.has("gains"))
    return keys.invalid("gains",
                        "belongs to a list of exposure times, not to exposures_s = \"auto\"");
  constexpr double kUsualError = .01;
  camera.light_error = kUsualError;
  if (!keys.has("light_error")) return {};
  PENUMBRA_ASSIGN(error, keys.number("light_error"));
  if (!(error > 0 && error < 1)) return keys.invalid("light_error", "is not above 0 and below 1");
  camera.light_error = error;
  return {};
}

Result<void> read_half(const TomlKeys& keys, RigCamera& camera) {
  if (!keys.has("half")) return {};
  PENUMBRA_ASSIGN(half, keys.text("half"));
  if (half != "left" && half != "right")
    return keys.invalid("half", "is neither \"left\" nor \"right\"");
  if (camera.light_error)
    return keys.invalid("half", "excludes exposures_s = \"auto\", which looks at whole pictures");
  camera.half = half == "left" ? StereoHalf::kLeft : StereoHalf::kRight;
  return {};
}

Result<RigCamera> read_rig_camera(const TomlKeys& keys) {
  std::vector<std::string_view> known(kCameraKeys.begin(), kCameraKeys.end());
  std::erase(known, "frames");
  known.insert(known.end(), std::begin(kDeviceKeys), std::end(kDeviceKeys));
  PENUMBRA_TRY(keys.only(known));
  RigCamera camera;
  PENUMBRA_ASSIGN(info, read_camera_info(keys));
  camera.info = std::move(info);
  const bool light = sees_light(camera.info.role);
  for (const char* key : {"exposures_s", "gains", "light_error", "white_balance_k", "unit_gain"})
    if (!light && keys.has(key)) return keys.invalid(key, no_light(camera.info.role));
  if (light) {
    if (!keys.has("response")) return keys.invalid("response", "is missing");
    PENUMBRA_ASSIGN(response, read_response(keys, {}));
    camera.info.response = response;
    PENUMBRA_TRY(read_white_balance(keys, camera.info.response));
  }
  PENUMBRA_ASSIGN(device, keys.text("device"));
  camera.settings.device = device;
  camera.settings.stop_automatics = light;
  if (camera.info.role == Role::kDepth) camera.settings.format = kDepthFormat;
  if (keys.has("format")) {
    PENUMBRA_ASSIGN(format, keys.text("format"));
    if (camera.info.role == Role::kDepth && format != kDepthFormat && format != "Y16")
      return keys.invalid("format", "is neither Z16 nor Y16, which a depth camera has");
    camera.settings.format = format;
  }
  if (keys.has("fps")) {
    PENUMBRA_ASSIGN(fps, keys.number("fps"));
    if (!(fps > 0 && fps <= 1000)) return keys.invalid("fps", "is not above 0 and at most 1000");
    camera.settings.fps = fps;
  }
  if (keys.has("unit_gain")) {
    PENUMBRA_ASSIGN(unit, keys.number("unit_gain"));
    if (!(unit > 0)) return keys.invalid("unit_gain", "is not positive");
    camera.settings.unit_gain = unit;
  }
  if (keys.has("white_balance_k")) {
    PENUMBRA_ASSIGN(kelvin, keys.number("white_balance_k"));
    if (!(kelvin >= 1000 && kelvin <= 25000))
      return keys.invalid("white_balance_k", "is not from 1000 to 25000 K");
    camera.settings.white_balance_k = kelvin;
  }
  if (keys.has("delay_frames")) {
    PENUMBRA_ASSIGN(delay, keys.integer("delay_frames", 1, 10));
    camera.delay_frames = delay;
  }
  PENUMBRA_TRY(read_exposures(keys, camera));
  PENUMBRA_TRY(read_half(keys, camera));
  return camera;
}

// A second camera of one device is the other half of its pictures, and says nothing else of it.
Result<void> check_same_device(const TomlKeys& keys, const RigCamera& camera,
                               const RigCamera& other) {
  const std::string& device = camera.settings.device;
  if (!camera.half || !other.half)
    return keys.invalid("device", fmt::format("\"{}\" is used twice", device));
  if (camera.half == other.half)
    return keys.invalid("half", fmt::format("is the same one of \"{}\" twice", device));
  if (camera.info.role != other.info.role)
    return keys.invalid(
        "role", fmt::format("is another one than of the other half, \"{}\"", other.info.name));
  for (const std::string_view key : kDeviceKeys)
    if (key != "device" && key != "half" && keys.has(key))
      return keys.invalid(std::string(key).c_str(),
                          fmt::format("is told with the other half, \"{}\"", other.info.name));
  const calib::CameraModel &a = camera.info.projection, &b = other.info.projection;
  if (a.width != b.width || a.height != b.height)
    return keys.invalid("width", fmt::format("and height differ from those of the other half, "
                                             "\"{}\"",
                                             other.info.name));
  return {};
}

}  // namespace

Result<std::vector<RigCamera>> read_rig_cameras(const fs::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  std::vector<RigCamera> cameras;
  for (const toml::table* table : list) {
    const TomlKeys camera_keys(path, *table);
    PENUMBRA_ASSIGN(camera, read_rig_camera(camera_keys));
    for (const RigCamera& other : cameras) {
      if (other.info.name == camera.info.name)
        return camera_keys.invalid("name", fmt::format("\"{}\" is used twice", other.info.name));
      if (other.settings.device == camera.settings.device)
        PENUMBRA_TRY(check_same_device(camera_keys, camera, other));
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

}  // namespace penumbra::capture
