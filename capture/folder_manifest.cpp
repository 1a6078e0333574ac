#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "capture/folder_format.h"
#include "capture/rig.h"
#include "codec/codec.h"
#include "core/toml_keys.h"

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kCameraKeys[] = {"name",
                                            "role",
                                            "eye",
                                            "width",
                                            "height",
                                            "projection",
                                            "focal_px",
                                            "principal_px",
                                            "distortion",
                                            "intrinsics",
                                            "response",
                                            "black_level",
                                            "white_balance",
                                            "frames",
                                            "world_from_camera",
                                            "full_well_electrons",
                                            "read_fraction",
                                            "psf_sigma_px",
                                            "colour",
                                            "pose",
                                            "noise"};

Result<glm::dvec2> read_pair(const TomlKeys& keys, std::string_view key) {
  PENUMBRA_ASSIGN(values, keys.numbers(key, 2));
  return glm::dvec2{values[0], values[1]};
}

Result<calib::Projection> read_own_projection(const TomlKeys& keys) {
  PENUMBRA_ASSIGN(name, keys.text("projection"));
  const auto kind = calib::projection_kind(name);
  if (!kind)
    return keys.invalid("projection", fmt::format("\"{}\": {}", name, kind.error().detail));
  PENUMBRA_ASSIGN(width, keys.integer("width", 1, codec::kMaxSide));
  PENUMBRA_ASSIGN(height, keys.integer("height", 1, codec::kMaxSide));
  constexpr double kMostPixels = 128e6;  // a frame, its light and its ring still fit into memory
  if (double(width) * height > kMostPixels)
    return keys.invalid("width", fmt::format("{} x {} pixels are more than {:.0f} million", width,
                                             height, kMostPixels / 1e6));
  auto projection = calib::make_projection(*kind, width, height);
  if (!projection) return keys.invalid("projection", name + ": " + projection.error().detail);
  for (const std::string_view key : {"focal_px", "principal_px"}) {
    if (!keys.has(key)) continue;
    if (!calib::has_intrinsics(*kind))
      return keys.invalid(key, "the projection " + name + " has none");
    PENUMBRA_ASSIGN(pair, read_pair(keys, key));
    if (key == "focal_px" && (pair.x <= 0 || pair.y <= 0)) return keys.invalid(key, "not positive");
    (key == "focal_px" ? projection->focal_px : projection->principal_px) = pair;
  }
  if (!keys.has("distortion")) return projection;
  PENUMBRA_ASSIGN(distortion, keys.numbers("distortion"));
  auto distorted = calib::with_distortion(*projection, distortion);
  if (!distorted) return keys.invalid("distortion", distorted.error().detail);
  return distorted;
}

/// A file of `calibrate camera`; other keys of it are its own.
Result<calib::Projection> read_intrinsics(const TomlKeys& keys, const fs::path& folder) {
  for (const std::string_view key : {"projection", "focal_px", "principal_px", "distortion"})
    if (keys.has(key)) return keys.invalid(key, "intrinsics has it already");
  PENUMBRA_ASSIGN(name, keys.text("intrinsics"));
  PENUMBRA_ASSIGN(camera, read_camera_file(folder / name));
  for (const auto& [key, size] :
       {std::pair{"width", camera.projection.width}, {"height", camera.projection.height}}) {
    if (!keys.has(key)) continue;
    PENUMBRA_ASSIGN(asked, keys.integer(key, 1, codec::kMaxSide));
    if (asked != size)
      return keys.invalid(key, fmt::format("{}, but {} is for {}", asked, name, size));
  }
  return camera.projection;
}

Result<calib::Projection> read_projection(const TomlKeys& keys, const fs::path& folder) {
  return keys.has("intrinsics") ? read_intrinsics(keys, folder) : read_own_projection(keys);
}

/// A rotation and a translation, column-major, within the rounding of a file's few digits.
Result<Pose> read_pose(const TomlKeys& keys) {
  constexpr std::string_view key = "world_from_camera";
  constexpr double tolerance = 1e-3;
  PENUMBRA_ASSIGN(m, keys.numbers(key, 16));
  if (m[3] != 0 || m[7] != 0 || m[11] != 0 || m[15] != 1)
    return keys.invalid(key, "the last row is not 0 0 0 1 (the list is column-major)");
  const glm::dmat3 r(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      if (std::abs(glm::dot(r[a], r[b]) - (a == b ? 1 : 0)) > tolerance)
        return keys.invalid(key, "not a rigid transform: its axes are not orthonormal");
  if (glm::determinant(r) < 0) return keys.invalid(key, "not a rigid transform: it mirrors");
  return Pose{glm::normalize(glm::quat_cast(r)), {m[12], m[13], m[14]}};
}

Result<void> read_identity(const TomlKeys& keys, CameraInfo& info) {
  PENUMBRA_ASSIGN(name, keys.text("name"));
  if (name.empty()) return keys.invalid("name", "empty");
  if (std::ranges::any_of(name, [](unsigned char c) { return std::iscntrl(c); }))
    return keys.invalid("name", "has control characters");
  PENUMBRA_ASSIGN(role, keys.text("role"));
  if (role != "environment" && role != "view")
    return keys.invalid("role", fmt::format("\"{}\", expected environment or view", role));
  info.name = name;
  info.role = role == "view" ? Role::kView : Role::kEnvironment;
  if (!keys.has("eye")) return {};
  PENUMBRA_ASSIGN(eye, keys.text("eye"));
  if (!eye.empty() && eye != "left" && eye != "right")
    return keys.invalid("eye", fmt::format("\"{}\", expected left or right", eye));
  info.eye = eye;
  return {};
}

/// A file of `calibrate noise`.
Result<void> read_noise(const TomlKeys& keys, const fs::path& folder, CameraInfo& info) {
  if (!keys.has("noise")) return {};
  for (const std::string_view key : {"black_level", "full_well_electrons", "read_fraction"})
    if (keys.has(key)) return keys.invalid(key, "noise has it already");
  PENUMBRA_ASSIGN(name, keys.text("noise"));
  PENUMBRA_ASSIGN(bytes, read_bytes(folder / name));
  PENUMBRA_ASSIGN(
      noise, calib::parse_noise_file({reinterpret_cast<const char*>(bytes.data()), bytes.size()},
                                     folder / name));
  info.noise = noise.model;
  info.noise_known = true;
  info.black_level = noise.black_level;
  return {};
}

Result<void> read_sensor(const TomlKeys& keys, CameraInfo& info) {
  if (keys.has("black_level")) {
    PENUMBRA_ASSIGN(black, keys.number("black_level"));
    if (black < 0 || black >= 1)
      return keys.invalid("black_level", "not within 0..1 of full scale");
    info.black_level = black;
  }
  if (keys.has("full_well_electrons")) {
    PENUMBRA_ASSIGN(electrons, keys.number("full_well_electrons"));
    if (electrons <= 0) return keys.invalid("full_well_electrons", "not positive");
    info.noise.full_well_electrons = electrons;
    info.noise_known = true;
  }
  if (keys.has("read_fraction")) {
    PENUMBRA_ASSIGN(read, keys.number("read_fraction"));
    if (read < 0 || read >= 1)
      return keys.invalid("read_fraction", "not within 0..1 of full scale");
    info.noise.read_fraction = read;
  }
  if (keys.has("psf_sigma_px")) {
    PENUMBRA_ASSIGN(sigma, keys.number("psf_sigma_px"));
    if (!(sigma >= 0 && sigma <= kLargestPsfSigma))
      return keys.invalid("psf_sigma_px", fmt::format("not within 0..{} pixels", kLargestPsfSigma));
    info.psf_sigma_px = sigma;
  }
  return {};
}

bool is_float_file(const FrameRow& row) {
  std::string extension = fs::path(row.file).extension().string();
  std::ranges::transform(extension, extension.begin(),
                         [](unsigned char c) { return std::tolower(c); });
  return extension == ".exr" || extension == ".hdr";
}

/// Codes mean nothing without a response; float frames need none.
Result<calib::Response> read_response(const TomlKeys& keys, const fs::path& folder,
                                      const std::vector<FrameRow>& rows) {
  if (!keys.has("response")) {
    if (std::ranges::all_of(rows, is_float_file)) return calib::Response::linear();
    return keys.invalid("response", "missing");
  }
  PENUMBRA_ASSIGN(text, keys.text("response"));
  auto response = calib::parse_response(text, folder);
  // An error within a response file already names that file and its line.
  if (!response && response.error().code == ErrorCode::kInvalid && response.error().where == text)
    return keys.invalid("response", fmt::format("\"{}\": {}", text, response.error().detail));
  return response;
}

/// Nine numbers by rows, or a file of `calibrate colour`.
Result<void> read_colour(const TomlKeys& keys, const fs::path& folder, CameraInfo& info) {
  if (!keys.has("colour")) return {};
  if (info.role != Role::kEnvironment)
    return keys.invalid("colour", "carries an environment camera's radiance to the view camera's");
  if (const auto name = keys.text("colour")) {
    PENUMBRA_ASSIGN(bytes, read_bytes(folder / *name));
    PENUMBRA_ASSIGN(
        matrix, calib::parse_colour_file(
                    {reinterpret_cast<const char*>(bytes.data()), bytes.size()}, folder / *name));
    info.colour = matrix;
    return {};
  }
  PENUMBRA_ASSIGN(m, keys.numbers("colour", 9));
  for (int i = 0; i < 9; ++i) info.colour[i % 3][i / 3] = m[static_cast<std::size_t>(i)];
  if (const auto carries = calib::check_colour_matrix(info.colour); !carries)
    return keys.invalid("colour", carries.error().detail);
  return {};
}

/// From a file of `calibrate rig`, by the camera's name.
Result<void> read_pose_file(const TomlKeys& keys, const fs::path& folder, CameraInfo& info) {
  if (!keys.has("pose")) return {};
  if (keys.has("world_from_camera")) return keys.invalid("pose", "world_from_camera is there, too");
  PENUMBRA_ASSIGN(name, keys.text("pose"));
  const fs::path path = folder / name;
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys file(path, root);
  PENUMBRA_TRY(file.version(1));
  PENUMBRA_ASSIGN(cameras, file.tables("camera"));
  for (const toml::table* table : cameras) {
    const TomlKeys camera(path, *table);
    PENUMBRA_ASSIGN(other, camera.text("name"));
    if (other != info.name) continue;
    PENUMBRA_ASSIGN(pose, read_pose(camera));
    info.world_from_camera = pose;
    return {};
  }
  return keys.invalid("pose", fmt::format("{} has no camera \"{}\"", name, info.name));
}

/// All of a camera but its frames and, since that may depend on them, its response. Keys are the caller's to check.
Result<CameraInfo> read_camera_info(const TomlKeys& keys, const fs::path& folder) {
  CameraInfo info;
  PENUMBRA_TRY(read_identity(keys, info));
  PENUMBRA_ASSIGN(projection, read_projection(keys, folder));
  info.projection = projection;
  PENUMBRA_TRY(read_noise(keys, folder, info));
  PENUMBRA_TRY(read_sensor(keys, info));
  PENUMBRA_TRY(read_colour(keys, folder, info));
  PENUMBRA_TRY(read_pose_file(keys, folder, info));
  if (keys.has("world_from_camera")) {
    PENUMBRA_ASSIGN(pose, read_pose(keys));
    info.world_from_camera = pose;
  }
  return info;
}

Result<void> read_white_balance(const TomlKeys& keys, calib::Response& response) {
  if (!keys.has("white_balance")) return {};
  PENUMBRA_ASSIGN(gains, keys.numbers("white_balance", 3));
  auto balanced = response.with_white_balance({gains[0], gains[1], gains[2]});
  if (!balanced) return keys.invalid("white_balance", balanced.error().detail);
  response = std::move(*balanced);
  return {};
}

Result<FolderCamera> read_camera(const TomlKeys& keys, const fs::path& folder) {
  FolderCamera camera;
  PENUMBRA_TRY(keys.only(kCameraKeys));
  PENUMBRA_ASSIGN(info, read_camera_info(keys, folder));
  camera.info = std::move(info);
  PENUMBRA_ASSIGN(list, keys.text("frames"));
  if (!stays_inside(list))
    return keys.invalid("frames", fmt::format("\"{}\" is not a path inside the folder", list));
  PENUMBRA_ASSIGN(rows, read_frame_list(folder, list));
  camera.rows = std::move(rows);
  PENUMBRA_ASSIGN(response, read_response(keys, folder, camera.rows));
  camera.info.response = response;
  PENUMBRA_TRY(read_white_balance(keys, camera.info.response));
  return camera;
}

constexpr std::string_view kDeviceKeys[] = {"device", "format",    "fps",          "exposures_s",
                                            "gains",  "unit_gain", "delay_frames", "light_error"};

Result<std::vector<Exposure>> read_schedule(const TomlKeys& keys) {
  std::vector<Exposure> schedule;
  if (!keys.has("exposures_s")) return schedule;
  constexpr std::size_t kMost = 16;
  PENUMBRA_ASSIGN(times, keys.numbers("exposures_s"));
  std::vector<double> gains(times.size(), 1.);
  if (keys.has("gains")) {
    PENUMBRA_ASSIGN(given, keys.numbers("gains", times.size()));
    gains = given;
  }
  if (times.empty() || times.size() > kMost)
    return keys.invalid("exposures_s", fmt::format("not \"auto\" or 1 to {} exposures", kMost));
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (!(times[i] > 0 && times[i] <= 60))
      return keys.invalid("exposures_s", "not within 0..60 seconds");
    if (!(gains[i] > 0 && gains[i] <= 1e4)) return keys.invalid("gains", "not within 0..10000");
    schedule.push_back({Seconds(times[i]), Gain(gains[i])});
  }
  return schedule;
}

// A schedule, or "auto" and what it has to reach.
Result<void> read_exposures(const TomlKeys& keys, RigCamera& camera) {
  const bool automatic = keys.text("exposures_s").value_or("") == "auto";
  if (!automatic) {
    if (keys.has("light_error"))
      return keys.invalid("light_error", "only with exposures_s = \"auto\"");
    PENUMBRA_ASSIGN(schedule, read_schedule(keys));
    camera.schedule = std::move(schedule);
    return {};
  }
  if (keys.has("gains")) return keys.invalid("gains", "not with exposures_s = \"auto\"");
  constexpr double kUsualError = .01;
  camera.light_error = kUsualError;
  if (!keys.has("light_error")) return {};
  PENUMBRA_ASSIGN(error, keys.number("light_error"));
  if (!(error > 0 && error < 1)) return keys.invalid("light_error", "not within 0..1");
  camera.light_error = error;
  return {};
}

Result<RigCamera> read_rig_camera(const TomlKeys& keys, const fs::path& folder) {
  std::vector<std::string_view> known(std::begin(kCameraKeys), std::end(kCameraKeys));
  std::erase(known, "frames");
  known.insert(known.end(), std::begin(kDeviceKeys), std::end(kDeviceKeys));
  PENUMBRA_TRY(keys.only(known));
  RigCamera camera;
  PENUMBRA_ASSIGN(info, read_camera_info(keys, folder));
  camera.info = std::move(info);
  if (!keys.has("response")) return keys.invalid("response", "missing");
  PENUMBRA_ASSIGN(response, read_response(keys, folder, {}));
  camera.info.response = response;
  PENUMBRA_TRY(read_white_balance(keys, camera.info.response));
  PENUMBRA_ASSIGN(device, keys.text("device"));
  camera.settings.device = device;
  if (keys.has("format")) {
    PENUMBRA_ASSIGN(format, keys.text("format"));
    camera.settings.format = format;
  }
  if (keys.has("fps")) {
    PENUMBRA_ASSIGN(fps, keys.number("fps"));
    if (!(fps > 0 && fps <= 1000)) return keys.invalid("fps", "not within 0..1000");
    camera.settings.fps = fps;
  }
  if (keys.has("unit_gain")) {
    PENUMBRA_ASSIGN(unit, keys.number("unit_gain"));
    if (!(unit > 0)) return keys.invalid("unit_gain", "not positive");
    camera.settings.unit_gain = unit;
  }
  if (keys.has("delay_frames")) {
    PENUMBRA_ASSIGN(delay, keys.integer("delay_frames", 1, 10));
    camera.delay_frames = delay;
  }
  PENUMBRA_TRY(read_exposures(keys, camera));
  return camera;
}

}  // namespace

Result<std::vector<FolderCamera>> read_manifest(const fs::path& folder) {
  const fs::path path = folder / kManifestName;
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "camera"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  if (list.empty()) return keys.invalid("camera", "no [[camera]]");
  std::vector<FolderCamera> cameras;
  for (const toml::table* table : list) {
    const TomlKeys camera_keys(path, *table);
    PENUMBRA_ASSIGN(camera, read_camera(camera_keys, folder));
    if (std::ranges::any_of(cameras,
                            [&](const auto& c) { return c.info.name == camera.info.name; }))
      return camera_keys.invalid("name", fmt::format("\"{}\" is used twice", camera.info.name));
    cameras.push_back(std::move(camera));
  }
  if (std::ranges::all_of(cameras, [](const auto& c) { return c.rows.empty(); }))
    return fail(ErrorCode::kInvalid, path.string(), "no camera has a frame");
  return cameras;
}

Result<std::vector<RigCamera>> read_rig_cameras(const fs::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  std::vector<RigCamera> cameras;
  for (const toml::table* table : list) {
    const TomlKeys camera_keys(path, *table);
    PENUMBRA_ASSIGN(camera, read_rig_camera(camera_keys, path.parent_path()));
    for (const RigCamera& other : cameras) {
      if (other.info.name == camera.info.name)
        return camera_keys.invalid("name", fmt::format("\"{}\" is used twice", other.info.name));
      if (other.settings.device == camera.settings.device)
        return camera_keys.invalid("device",
                                   fmt::format("\"{}\" is used twice", other.settings.device));
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

Result<std::vector<CameraInfo>> read_cameras(const toml::table& root, const fs::path& path,
                                             const FindResponse& response) {
  const TomlKeys keys(path, root);
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  if (list.empty()) return keys.invalid("camera", "no [[camera]]");
  std::vector<CameraInfo> cameras;
  for (const toml::table* table : list) {
    const TomlKeys camera_keys(path, *table);
    PENUMBRA_TRY(camera_keys.only(kCameraKeys));
    PENUMBRA_ASSIGN(info, read_camera_info(camera_keys, path.parent_path()));
    PENUMBRA_ASSIGN(name, camera_keys.text("response"));
    PENUMBRA_ASSIGN(found, response(name));
    info.response = found;
    PENUMBRA_TRY(read_white_balance(camera_keys, info.response));
    if (std::ranges::any_of(cameras, [&](const auto& c) { return c.name == info.name; }))
      return camera_keys.invalid("name", fmt::format("\"{}\" is used twice", info.name));
    cameras.push_back(std::move(info));
  }
  return cameras;
}

Result<CameraInfo> read_camera_file(const fs::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "camera", "calibration"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  if (list.size() != 1)
    return keys.invalid("camera", fmt::format("{} cameras, expected one", list.size()));
  const TomlKeys camera_keys(path, *list[0]);
  PENUMBRA_TRY(camera_keys.only(kCameraKeys));
  return read_camera_info(camera_keys, path.parent_path());
}

std::string print_camera(const CameraInfo& c, const std::string& response) {
  const auto& p = c.projection;
  std::string text = fmt::format("\n[[camera]]\nname = {}\nrole = \"{}\"\n", toml_quoted(c.name),
                                 c.role == Role::kView ? "view" : "environment");
  if (!c.eye.empty()) text += fmt::format("eye = \"{}\"\n", c.eye);
  text += fmt::format("width = {}\nheight = {}\nprojection = \"{}\"\n", p.width, p.height,
                      calib::projection_name(p.kind));
  if (calib::has_intrinsics(p.kind))
    text += fmt::format("focal_px = [{}, {}]\nprincipal_px = [{}, {}]\n", p.focal_px.x,
                        p.focal_px.y, p.principal_px.x, p.principal_px.y);
  if (p.is_distorted())
    text += fmt::format("distortion = [{}]\n",
                        fmt::join(p.distortion.begin(),
                                  p.distortion.begin() + calib::distortion_count(p.kind), ", "));
  text += fmt::format("response = {}\nblack_level = {}\n", toml_quoted(response), c.black_level);
  const auto& gains = c.response.white_balance();
  // A response file has the gains in its tables.
  if (gains != std::array<double, 3>{1, 1, 1} && response == c.response.describe())
    text += fmt::format("white_balance = [{}]\n", fmt::join(gains, ", "));
  const calib::NoiseModel usual;
  if (c.noise_known || c.noise.full_well_electrons != usual.full_well_electrons)
    text += fmt::format("full_well_electrons = {}\n", c.noise.full_well_electrons);
  if (c.noise_known || c.noise.read_fraction != usual.read_fraction)
    text += fmt::format("read_fraction = {}\n", c.noise.read_fraction);
  if (c.psf_sigma_px > 0) text += fmt::format("psf_sigma_px = {}\n", c.psf_sigma_px);
  if (c.colour != glm::dmat3(1)) {
    const glm::dmat3 rows = glm::transpose(c.colour);
    text += fmt::format("colour = [{}]\n", fmt::join(&rows[0][0], &rows[0][0] + 9, ", "));
  }
  const glm::dmat4 m = c.world_from_camera.matrix();
  text += fmt::format("world_from_camera = [{}]\n", fmt::join(&m[0][0], &m[0][0] + 16, ", "));
  return text;
}

std::string print_manifest(const std::vector<CameraInfo>& cameras,
                           const std::vector<std::string>& responses) {
  std::string text = "version = 1\n";
  for (std::size_t i = 0; i < cameras.size(); ++i)
    text += print_camera(cameras[i], responses[i]) +
            fmt::format("frames = {}\n", toml_quoted(cameras[i].name + ".csv"));
  return text;
}

}  // namespace penumbra::capture
