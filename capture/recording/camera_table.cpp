#include "capture/recording/camera_table.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "calib/camera/calibration_files.h"
#include "calib/camera/camera_model.h"
#include "calib/camera/colour.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/noise.h"
#include "calib/camera/pose_file.h"
#include "calib/camera/response.h"
#include "capture/camera_regions.h"
#include "capture/frames.h"
#include "codec/codec.h"
#include "core/conventions.h"
#include "core/io/files.h"

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kLensKeys[] = {"crop_px",      "projection",      "focal_px",
                                          "principal_px", "distortion",      "intrinsics",
                                          "fov_deg",      "camera_from_lens"};
constexpr std::string_view kBallKeys[] = {"outline_px", "centre_m", "radius_m", "reflectance"};

Result<glm::dvec2> read_pair(const TomlKeys& keys, std::string_view key) {
  PENUMBRA_ASSIGN(values, keys.numbers(key, 2));
  return glm::dvec2{values[0], values[1]};
}

struct Size {
  int width = 0, height = 0;
};

Result<Size> read_size(const TomlKeys& keys) {
  PENUMBRA_ASSIGN(width, keys.integer("width", 1, codec::kMaxSide));
  PENUMBRA_ASSIGN(height, keys.integer("height", 1, codec::kMaxSide));
  constexpr double kMaxPixels = 128e6;  // a frame, its light and its ring still fit into memory
  if (double(width) * height > kMaxPixels)
    return keys.invalid("width", fmt::format("{} x {} pixels are more than {:.0f} million", width,
                                             height, kMaxPixels / 1e6));
  return Size{width, height};
}

Result<calib::CameraModel> read_own_projection(const TomlKeys& keys, const Size& size) {
  PENUMBRA_ASSIGN(name, keys.text("projection"));
  const auto kind = calib::projection_kind(name);
  if (!kind) return keys.invalid("projection", fmt::format("\"{}\" {}", name, kind.error().detail));
  auto projection = calib::make_projection(*kind, size.width, size.height);
  if (!projection) return keys.invalid("projection", name + ": " + projection.error().detail);
  for (const std::string_view key : {"focal_px", "principal_px"}) {
    if (!keys.has(key)) continue;
    if (!calib::has_intrinsics(*kind))
      return keys.invalid(key, "the projection " + name + " has none");
    PENUMBRA_ASSIGN(pair, read_pair(keys, key));
    if (key == "focal_px" && (pair.x <= 0 || pair.y <= 0))
      return keys.invalid(key, "is not positive");
    (key == "focal_px" ? projection->focal_px : projection->principal_px) = pair;
  }
  if (!keys.has("distortion")) return projection;
  PENUMBRA_ASSIGN(distortion, keys.numbers("distortion"));
  auto distorted = calib::with_distortion(*projection, distortion);
  if (!distorted) return keys.invalid("distortion", distorted.error().detail);
  return distorted;
}

/// A file of `calibrate camera`: one camera with a projection of its own; its other keys are its
/// own, too.
Result<calib::CameraModel> read_lens_file(const fs::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys file(path, root);
  PENUMBRA_TRY(file.version(1));
  PENUMBRA_ASSIGN(list, file.tables("camera"));
  if (list.size() != 1)
    return file.invalid("camera", fmt::format("has {} cameras instead of one", list.size()));
  const TomlKeys keys(path, *list[0]);
  for (const std::string_view key : {"intrinsics", "lens"})
    if (keys.has(key))
      return keys.invalid(
          key, "does not belong in a file of intrinsics, which has a projection of its own");
  PENUMBRA_ASSIGN(size, read_size(keys));
  return read_own_projection(keys, size);
}

Result<calib::CameraModel> read_intrinsics(const TomlKeys& keys) {
  for (const std::string_view key : {"projection", "focal_px", "principal_px", "distortion"})
    if (keys.has(key)) return keys.invalid(key, "is already in the file of intrinsics");
  PENUMBRA_ASSIGN(name, keys.text("intrinsics"));
  PENUMBRA_ASSIGN(projection, read_lens_file(keys.path().parent_path() / name));
  for (const auto& [key, size] :
       {std::pair{"width", projection.width}, {"height", projection.height}}) {
    if (!keys.has(key)) continue;
    PENUMBRA_ASSIGN(asked, keys.integer(key, 1, codec::kMaxSide));
    if (asked != size)
      return keys.invalid(key, fmt::format("is {}, but {} is for {}", asked, name, size));
  }
  return projection;
}

Result<calib::CameraModel> read_projection(const TomlKeys& keys) {
  if (keys.has("intrinsics")) return read_intrinsics(keys);
  PENUMBRA_ASSIGN(size, read_size(keys));
  return read_own_projection(keys, size);
}

/// A rotation and a translation, column-major, within the rounding of a file's few digits.
Result<Pose> read_pose(const TomlKeys& keys, std::string_view key = "world_from_camera") {
  PENUMBRA_ASSIGN(m, keys.numbers(key, 16));
  const auto pose = calib::pose_from_matrix(m);
  if (!pose) return keys.invalid(key, pose.error().detail);
  return *pose;
}

Result<void> read_identity(const TomlKeys& keys, CameraInfo& info) {
  PENUMBRA_ASSIGN(name, keys.text("name"));
  if (name.empty()) return keys.invalid("name", "is empty");
  if (std::ranges::any_of(name, [](unsigned char c) { return std::iscntrl(c); }))
    return keys.invalid("name", "has control characters");
  PENUMBRA_ASSIGN(role, keys.text("role"));
  const auto known = role_from(role);
  if (!known)
    return keys.invalid("role",
                        fmt::format("\"{}\" is none of environment, view, depth and mask", role));
  info.name = name;
  info.role = *known;
  if (!keys.has("eye")) return {};
  PENUMBRA_ASSIGN(eye, keys.text("eye"));
  if (!eye.empty() && eye != "left" && eye != "right")
    return keys.invalid("eye", fmt::format("\"{}\" is neither left nor right", eye));
  info.eye = eye;
  return {};
}

/// Depth and masks are no pictures of light.
Result<void> refuse_light(const TomlKeys& keys, Role role) {
  if (sees_light(role)) return {};
  for (const std::string_view key :
       {"eye", "response", "black_level", "white_balance", "full_well_electrons", "read_noise",
        "noise", "psf_sigma_px", "colour", "vignetting", "lens", "ball"})
    if (keys.has(key)) return keys.invalid(key, no_light(role));
  return {};
}

/// A file of `calibrate noise`.
Result<void> noise_in(const TomlKeys& keys, CameraInfo& info) {
  if (!keys.has("noise")) return {};
  for (const std::string_view key : {"black_level", "full_well_electrons", "read_noise"})
    if (keys.has(key)) return keys.invalid(key, "is already in the noise file");
  PENUMBRA_ASSIGN(name, keys.text("noise"));
  PENUMBRA_ASSIGN(bytes, read_bytes(keys.path().parent_path() / name));
  PENUMBRA_ASSIGN(
      noise, calib::parse_noise_file({reinterpret_cast<const char*>(bytes.data()), bytes.size()},
                                     keys.path().parent_path() / name));
  info.noise = noise.model;
  info.noise_known = true;
  info.black_level = noise.black_level;
  return {};
}

Result<void> read_sensor(const TomlKeys& keys, CameraInfo& info) {
  if (keys.has("black_level")) {
    PENUMBRA_ASSIGN(black, keys.number("black_level"));
    if (black < 0 || black >= 1)
      return keys.invalid("black_level", "is not within 0..1 of full scale");
    info.black_level = black;
  }
  if (keys.has("full_well_electrons")) {
    PENUMBRA_ASSIGN(electrons, keys.number("full_well_electrons"));
    if (electrons <= 0) return keys.invalid("full_well_electrons", "is not positive");
    info.noise.full_well_electrons = electrons;
    info.noise_known = true;
  }
  if (keys.has("read_noise")) {
    PENUMBRA_ASSIGN(read, keys.number("read_noise"));
    if (read < 0 || read >= 1)
      return keys.invalid("read_noise", "is not within 0..1 of full scale");
    info.noise.read_noise = read;
  }
  if (keys.has("psf_sigma_px")) {
    PENUMBRA_ASSIGN(sigma, keys.number("psf_sigma_px"));
    if (!(sigma >= 0 && sigma <= kLargestPsfSigma))
      return keys.invalid("psf_sigma_px",
                          fmt::format("is not within 0..{} pixels", kLargestPsfSigma));
    info.psf_sigma_px = sigma;
  }
  return {};
}

bool is_float_file(const FrameRow& row) {
  const std::string extension = lower_extension(row.file);
  return extension == ".exr" || extension == ".hdr" || extension == ".jph" || extension == ".jp2" ||
         extension == ".pnr";
}

/// Three terms, or a file of `calibrate vignetting`.
Result<void> read_vignetting(const TomlKeys& keys, CameraInfo& info) {
  if (!keys.has("vignetting")) return {};
  if (const auto name = keys.text("vignetting")) {
    const fs::path path = keys.path().parent_path() / *name;
    PENUMBRA_ASSIGN(bytes, read_bytes(path));
    PENUMBRA_ASSIGN(terms, calib::parse_vignetting_file(
                               {reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path));
    info.vignetting = terms;
  } else {
    PENUMBRA_ASSIGN(terms, keys.numbers("vignetting", 3));
    info.vignetting = {terms[0], terms[1], terms[2]};
  }
  if (!calib::has_intrinsics(info.projection.kind))
    return keys.invalid(
        "vignetting", "the projection " +
                          std::string(calib::projection_name(info.projection.kind)) + " has none");
  const auto plausible = [&](const calib::CameraModel& p) {
    return calib::is_plausible(calib::vignetting_of(p, info.vignetting), p);
  };
  if (info.lenses.empty() ? plausible(info.projection)
                          : std::ranges::all_of(info.lenses, plausible, &Lens::projection))
    return {};
  return keys.invalid("vignetting",
                      "leaves less than 2 % or more than 150 % of the light somewhere");
}

/// Nine numbers by rows, or a file of `calibrate colour`.
Result<void> read_colour(const TomlKeys& keys, CameraInfo& info) {
  if (!keys.has("colour")) return {};
  if (info.role != Role::kEnvironment)
    return keys.invalid(
        "colour",
        "belongs to an environment camera: it maps that camera's colours to the view camera's");
  if (const auto name = keys.text("colour")) {
    PENUMBRA_ASSIGN(bytes, read_bytes(keys.path().parent_path() / *name));
    PENUMBRA_ASSIGN(matrix, calib::parse_colour_file(
                                {reinterpret_cast<const char*>(bytes.data()), bytes.size()},
                                keys.path().parent_path() / *name));
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
Result<void> read_pose_file(const TomlKeys& keys, CameraInfo& info) {
  if (!keys.has("pose")) return {};
  if (keys.has("world_from_camera"))
    return keys.invalid("pose", "is given besides world_from_camera: keep one of them");
  PENUMBRA_ASSIGN(name, keys.text("pose"));
  const fs::path path = keys.path().parent_path() / name;
  PENUMBRA_ASSIGN(text, read_text(path, std::size_t{1} << 26));
  PENUMBRA_ASSIGN(file, calib::parse_pose_file(text, path));
  if (file.poses_in == calib::PosesIn::kTrackedBody)
    return keys.invalid("pose", fmt::format("{} has poses on a tracked body, not in the world: it "
                                            "is a calibration for [pose] of rig.toml",
                                            name));
  for (const auto& [camera, pose] : file.cameras) {
    if (camera != info.name) continue;
    info.world_from_camera = pose;
    return {};
  }
  return keys.invalid("pose", fmt::format("{} has no camera \"{}\"", name, info.name));
}

/// A part of a picture of this size.
Result<Lens> read_lens(const TomlKeys& keys, const Size& picture) {
  PENUMBRA_TRY(keys.only(kLensKeys));
  Lens lens;
  Size size = picture;
  if (keys.has("crop_px")) {
    PENUMBRA_ASSIGN(crop, keys.numbers("crop_px", 4));
    const bool inside = crop[0] >= 0 && crop[1] >= 0 && crop[2] >= 2 && crop[3] >= 2 &&
                        crop[0] + crop[2] <= picture.width && crop[1] + crop[3] <= picture.height;
    if (!inside || std::ranges::any_of(crop, [](double c) { return c != std::floor(c); }))
      return keys.invalid("crop_px",
                          fmt::format("is not x, y, width, height in whole pixels inside {} x {}",
                                      picture.width, picture.height));
    lens.x_px = static_cast<int>(crop[0]), lens.y_px = static_cast<int>(crop[1]);
    size = {static_cast<int>(crop[2]), static_cast<int>(crop[3])};
  }
  PENUMBRA_ASSIGN(projection,
                  keys.has("intrinsics") ? read_intrinsics(keys) : read_own_projection(keys, size));
  if (projection.width != size.width || projection.height != size.height)
    return keys.invalid("intrinsics",
                        fmt::format("is for {} x {}, but the lens has {} x {}", projection.width,
                                    projection.height, size.width, size.height));
  if (!calib::has_intrinsics(projection.kind))
    return keys.invalid(
        "projection", "is none of equidistant, kb4, double-sphere and pinhole, which a lens needs");
  lens.projection = projection;
  PENUMBRA_ASSIGN(fov_deg, keys.number("fov_deg"));
  if (!(fov_deg > 0 && fov_deg <= 360))
    return keys.invalid("fov_deg", "is not above 0 and at most 360 degrees");
  lens.half_field_of_view_rad = fov_deg / 360 * kPi;
  if (!keys.has("camera_from_lens")) return lens;
  PENUMBRA_ASSIGN(pose, read_pose(keys, "camera_from_lens"));
  lens.camera_from_lens = pose.rotation;
  return lens;
}

/// Where a camera has them; its projection is then the first lens's, in the coordinates of the
/// whole picture.
Result<void> read_lenses(const TomlKeys& keys, CameraInfo& info) {
  constexpr std::size_t kMax = 16;
  for (const std::string_view key :
       {"projection", "intrinsics", "focal_px", "principal_px", "distortion"})
    if (keys.has(key)) return keys.invalid(key, "belongs into each [[camera.lens]]");
  PENUMBRA_ASSIGN(tables, keys.tables("lens"));
  if (tables.empty() || tables.size() > kMax)
    return keys.invalid("lens",
                        fmt::format("has {} lenses instead of 1 to {}", tables.size(), kMax));
  PENUMBRA_ASSIGN(size, read_size(keys));
  for (const toml::table* table : tables) {
    PENUMBRA_ASSIGN(lens, read_lens(TomlKeys(keys.path(), *table), size));
    info.lenses.push_back(lens);
  }
  const Lens& first = info.lenses.front();
  info.projection = first.projection;
  info.projection.principal_px += glm::dvec2(first.x_px, first.y_px);
  info.projection.width = size.width, info.projection.height = size.height;
  return {};
}

Result<void> read_ball(const TomlKeys& keys, CameraInfo& info) {
  PENUMBRA_TRY(keys.only(kBallKeys));
  Ball ball;
  if (keys.has("outline_px") == keys.has("centre_m"))
    return keys.invalid(keys.has("centre_m") ? "centre_m" : "ball",
                        "needs either outline_px, or centre_m and radius_m");
  if (keys.has("outline_px")) {
    PENUMBRA_ASSIGN(o, keys.numbers("outline_px", 3));
    if (keys.has("radius_m"))
      return keys.invalid("radius_m", "belongs to centre_m, not to outline_px");
    if (!(o[2] > 0)) return keys.invalid("outline_px", "has a radius that is not positive");
    ball.outline_px = Ball::OutlinePixels{{o[0], o[1]}, o[2]};
    info.ball = ball;
    if (const auto seen = camera_regions(info, {}); !seen)
      return keys.invalid("outline_px", seen.error().detail);
  } else {
    PENUMBRA_ASSIGN(c, keys.numbers("centre_m", 3));
    PENUMBRA_ASSIGN(radius, keys.number("radius_m"));
    if (!(radius > 0)) return keys.invalid("radius_m", "is not positive");
    ball.centre_m = {c[0], c[1], c[2]};
    ball.radius_m = radius;
  }
  info.ball = ball;
  if (!keys.has("reflectance")) return {};
  PENUMBRA_ASSIGN(r, keys.numbers("reflectance", 3));
  for (const double c : r)
    if (!(c > 0 && c <= 1))
      return keys.invalid("reflectance", "has a number that is not above 0 and at most 1");
  info.ball_reflectance = {static_cast<float>(r[0]), static_cast<float>(r[1]),
                           static_cast<float>(r[2])};
  return {};
}

Result<void> read_depth(const TomlKeys& keys, CameraInfo& info) {
  if (!keys.has("depth_unit_m")) return {};
  if (info.role != Role::kDepth)
    return keys.invalid("depth_unit_m", "belongs to a camera with role = \"depth\"");
  PENUMBRA_ASSIGN(unit, keys.number("depth_unit_m"));
  if (!(unit >= 1e-6 && unit <= 1)) return keys.invalid("depth_unit_m", "is not within 1e-6..1 m");
  info.depth_unit_m = unit;
  return {};
}

/// What else than its whole picture shows the surroundings.
Result<void> read_regions(const TomlKeys& keys, CameraInfo& info) {
  if (keys.has("lens")) {
    PENUMBRA_TRY(read_lenses(keys, info));
    if (info.role != Role::kEnvironment)
      return keys.invalid("lens", "belongs to environment cameras only");
  } else {
    PENUMBRA_ASSIGN(projection, read_projection(keys));
    info.projection = projection;
  }
  if (!keys.has("ball")) return {};
  if (info.role != Role::kView) return keys.invalid("ball", "belongs to view cameras only");
  PENUMBRA_ASSIGN(ball, keys.table("ball"));
  return read_ball(ball, info);
}

}  // namespace

std::string no_light(Role role) {
  return fmt::format("means nothing of a camera with role = \"{}\"", role_name(role));
}

Result<calib::Response> read_response(const TomlKeys& keys, const std::vector<FrameRow>& rows) {
  if (!keys.has("response")) {
    if (std::ranges::all_of(rows, is_float_file)) return calib::Response::linear();
    return keys.invalid("response", "is missing");
  }
  PENUMBRA_ASSIGN(text, keys.text("response"));
  auto response = calib::parse_response(text, keys.path().parent_path());
  // An error within a response file already names that file and its line.
  if (!response && response.error().code == ErrorCode::kInvalid && response.error().where == text)
    return keys.invalid("response", fmt::format("\"{}\": {}", text, response.error().detail));
  return response;
}

Result<CameraInfo> read_camera_info(const TomlKeys& keys) {
  CameraInfo info;
  PENUMBRA_TRY(read_identity(keys, info));
  PENUMBRA_TRY(refuse_light(keys, info.role));
  PENUMBRA_TRY(read_regions(keys, info));
  PENUMBRA_TRY(noise_in(keys, info));
  PENUMBRA_TRY(read_sensor(keys, info));
  PENUMBRA_TRY(read_vignetting(keys, info));
  PENUMBRA_TRY(read_colour(keys, info));
  PENUMBRA_TRY(read_depth(keys, info));
  PENUMBRA_TRY(read_pose_file(keys, info));
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

namespace {

std::string print_projection(const calib::CameraModel& p) {
  std::string text = fmt::format("projection = \"{}\"\n", calib::projection_name(p.kind));
  if (calib::has_intrinsics(p.kind))
    text += fmt::format("focal_px = [{}, {}]\nprincipal_px = [{}, {}]\n", p.focal_px.x,
                        p.focal_px.y, p.principal_px.x, p.principal_px.y);
  if (p.is_distorted())
    text += fmt::format("distortion = [{}]\n",
                        fmt::join(p.distortion.begin(),
                                  p.distortion.begin() + calib::distortion_count(p.kind), ", "));
  return text;
}

std::string print_lens(const Lens& lens) {
  const glm::dmat4 m = glm::mat4_cast(lens.camera_from_lens);
  return fmt::format(
      "\n[[camera.lens]]\ncrop_px = [{}, {}, {}, {}]\n{}fov_deg = {}\ncamera_from_lens = [{}]\n",
      lens.x_px, lens.y_px, lens.projection.width, lens.projection.height,
      print_projection(lens.projection), lens.half_field_of_view_rad * 360 / kPi,
      fmt::join(&m[0][0], &m[0][0] + 16, ", "));
}

std::string print_ball(const Ball& ball, const Rgb& reflectance) {
  const std::string where =
      ball.outline_px ? fmt::format("outline_px = [{}, {}, {}]\n", ball.outline_px->centre.x,
                                    ball.outline_px->centre.y, ball.outline_px->radius)
                      : fmt::format("centre_m = [{}, {}, {}]\nradius_m = {}\n", ball.centre_m.x,
                                    ball.centre_m.y, ball.centre_m.z, ball.radius_m);
  return fmt::format("\n[camera.ball]\n{}reflectance = [{}, {}, {}]\n", where, reflectance.r,
                     reflectance.g, reflectance.b);
}

std::string print_regions(const CameraInfo& c) {
  std::string text;
  for (const Lens& lens : c.lenses) text += print_lens(lens);
  if (c.ball) text += print_ball(*c.ball, c.ball_reflectance);
  return text;
}

}  // namespace

std::string print_camera(const CameraInfo& c, const std::string& response,
                         const std::string& frames) {
  std::string text = fmt::format("\n[[camera]]\nname = {}\nrole = \"{}\"\n", toml_quoted(c.name),
                                 role_name(c.role));
  if (!c.eye.empty()) text += fmt::format("eye = \"{}\"\n", c.eye);
  text += fmt::format("width = {}\nheight = {}\n", c.projection.width, c.projection.height);
  if (c.lenses.empty()) text += print_projection(c.projection);
  if (sees_light(c.role))
    text += fmt::format("response = {}\nblack_level = {}\n", toml_quoted(response), c.black_level);
  if (c.role == Role::kDepth) text += fmt::format("depth_unit_m = {}\n", c.depth_unit_m);
  const auto& gains = c.response.white_balance();
  // A response file has the gains in its tables.
  if (gains != std::array<double, 3>{1, 1, 1} && response == c.response.describe())
    text += fmt::format("white_balance = [{}]\n", fmt::join(gains, ", "));
  const calib::NoiseModel usual;
  if (c.noise_known || c.noise.full_well_electrons != usual.full_well_electrons)
    text += fmt::format("full_well_electrons = {}\n", c.noise.full_well_electrons);
  if (c.noise_known || c.noise.read_noise != usual.read_noise)
    text += fmt::format("read_noise = {}\n", c.noise.read_noise);
  if (c.psf_sigma_px > 0) text += fmt::format("psf_sigma_px = {}\n", c.psf_sigma_px);
  if (c.vignetting != std::array<double, 3>{})
    text += fmt::format("vignetting = [{}]\n", fmt::join(c.vignetting, ", "));
  if (c.colour != glm::dmat3(1)) {
    const glm::dmat3 rows = glm::transpose(c.colour);
    text += fmt::format("colour = [{}]\n", fmt::join(&rows[0][0], &rows[0][0] + 9, ", "));
  }
  const glm::dmat4 m = c.world_from_camera.matrix();
  text += fmt::format("world_from_camera = [{}]\n", fmt::join(&m[0][0], &m[0][0] + 16, ", "));
  if (!frames.empty()) text += fmt::format("frames = {}\n", toml_quoted(frames));
  return text + print_regions(c);
}

}  // namespace penumbra::capture
