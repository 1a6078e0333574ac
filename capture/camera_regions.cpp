#include "capture/camera_regions.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/mirror_ball.h"
#include "calib/camera/vignetting.h"
#include "core/conventions.h"

namespace penumbra::capture {

namespace {

// Distance to the nearest edge over half the shorter side.
double from_edge(const glm::dvec2& px, int width, int height) {
  const double nearest = std::min(std::min(px.x, width - px.x), std::min(px.y, height - px.y));
  return std::clamp(2 * nearest / std::min(width, height), 0., 1.);
}

// As many rows as are resolved over half a turn.
int rows_of(const calib::CameraModel& p) {
  const double rows = calib::has_intrinsics(p.kind) ? kPi * p.focal_px.y : p.height;
  constexpr double kMax = 1 << 20;
  return static_cast<int>(std::min(rows, kMax));
}

Result<void> check_size(const CameraInfo& camera, int width, int height) {
  if (width >= 2 && height >= 2) return {};
  return fail(ErrorCode::kInvalid, camera.name,
              "is smaller than 2x2 pixels, and an environment camera needs at least that");
}

CameraRegion lens_visibility(const Lens& lens, const std::array<double, 3>& vignetting) {
  const Vignetting left = calib::vignetting_of(lens.projection, vignetting);
  const glm::dquat lens_from_camera = glm::conjugate(lens.camera_from_lens);
  const PixelLookup find_pixel = [lens, lens_from_camera,
                                  left](const glm::dvec3& d) -> std::optional<PixelHit> {
    const glm::dvec3 in_lens = lens_from_camera * d;
    const double off_axis = std::atan2(std::hypot(in_lens.x, in_lens.y), -in_lens.z);
    if (off_axis > lens.half_field_of_view_rad) return std::nullopt;
    const auto px = calib::pixel_from_direction(lens.projection, in_lens);
    if (!px) return std::nullopt;
    const auto& p = lens.projection;
    return PixelHit{
        *px,
        std::min(from_edge(*px, p.width, p.height), 1 - off_axis / lens.half_field_of_view_rad),
        left.at(*px)};
  };
  return {lens.x_px,
          lens.y_px,
          lens.projection.width,
          lens.projection.height,
          rows_of(lens.projection),
          find_pixel,
          lens.projection,
          lens.camera_from_lens,
          !left.none()};
}

Result<calib::MirrorBall> find_ball(const CameraInfo& camera, const Pose& world_from_camera) {
  const Ball& ball = *camera.ball;
  if (ball.outline_px)
    return calib::MirrorBall::from_outline(camera.projection, ball.outline_px->centre,
                                           ball.outline_px->radius);
  return calib::MirrorBall::at(world_from_camera.inverse() * ball.centre_m, ball.radius_m);
}

// Of the outline in the picture, whatever the lens makes of it.
struct PixelBounds {
  glm::dvec2 low{1e9}, high{-1e9};
};
std::optional<PixelBounds> bounds_of(const calib::MirrorBall& ball,
                                     const calib::CameraModel& camera) {
  const glm::dvec3 axis = ball.direction();
  const glm::dvec3 any = std::abs(axis.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0);
  const glm::dvec3 u = glm::normalize(glm::cross(axis, any)), v = glm::cross(u, axis);
  const double angle = ball.angular_radius_rad();
  PixelBounds bounds;
  constexpr int kPoints = 64;
  for (int i = 0; i < kPoints; ++i) {
    const double turn = 2 * kPi * i / kPoints;
    const auto px = calib::pixel_from_direction(
        camera,
        axis * std::cos(angle) + (u * std::cos(turn) + v * std::sin(turn)) * std::sin(angle));
    if (!px) return std::nullopt;
    bounds = {glm::min(bounds.low, *px), glm::max(bounds.high, *px)};
  }
  return bounds;
}

Result<CameraRegion> ball_region(const CameraInfo& camera, const Pose& world_from_camera) {
  const auto undetermined = [&](const std::string& why) {
    return fail(ErrorCode::kUndetermined, camera.name, "the mirror ball " + why);
  };
  const auto found = find_ball(camera, world_from_camera);
  // A tracker that jumps may put the camera anywhere.
  if (!found) return undetermined("cannot be found in the picture: " + found.error().detail);
  const calib::MirrorBall& ball = *found;
  const auto bounds = bounds_of(ball, camera.projection);
  if (!bounds) return undetermined("is partly outside the picture");
  const int x = static_cast<int>(bounds->low.x), y = static_cast<int>(bounds->low.y);
  const int width =
      std::min(static_cast<int>(std::ceil(bounds->high.x)), camera.projection.width) - x;
  const int height =
      std::min(static_cast<int>(std::ceil(bounds->high.y)), camera.projection.height) - y;
  constexpr int kSmallest_px = 8;
  if (std::min(width, height) < kSmallest_px)
    return undetermined(fmt::format("is only {} x {} pixels large", width, height));
  const PixelLookup find_pixel = [ball, projection = camera.projection,
                                  left = calib::vignetting_of(camera.projection, camera.vignetting),
                                  x, y](const glm::dvec3& d) -> std::optional<PixelHit> {
    const auto seen = ball.ray_from_light(d);
    if (!seen) return std::nullopt;
    const auto px = calib::pixel_from_direction(projection, seen->ray);
    if (!px) return std::nullopt;
    return PixelHit{*px - glm::dvec2(x, y), seen->from_rim, left.at(*px)};
  };
  // In the middle a ball of radius r shows r / 2 pixels a radian.
  return CameraRegion{x,
                      y,
                      width,
                      height,
                      static_cast<int>(kPi * width / 4),
                      find_pixel,
                      std::nullopt,
                      {1, 0, 0, 0},
                      false};
}

template <class Pixel>
Image<Pixel> cut(const Image<Pixel>& picture, const CameraRegion& part) {
  Image<Pixel> out(part.width, part.height);
  for (int y = 0; y < part.height; ++y)
    std::ranges::copy(
        picture.row(part.y_px + y)
            .subspan(static_cast<std::size_t>(part.x_px), static_cast<std::size_t>(part.width)),
        out.row(y).begin());
  return out;
}

}  // namespace

CameraRegion plain_region(const calib::CameraModel& p, const std::array<double, 3>& vignetting) {
  const Vignetting left = calib::vignetting_of(p, vignetting);
  const bool whole_sphere = !calib::has_intrinsics(p.kind);
  const PixelLookup find_pixel = [p, whole_sphere,
                                  left](const glm::dvec3& d) -> std::optional<PixelHit> {
    const auto px = calib::pixel_from_direction(p, d);
    if (!px) return std::nullopt;
    return PixelHit{*px, whole_sphere ? 1 : from_edge(*px, p.width, p.height), left.at(*px)};
  };
  return {0, 0, p.width, p.height, rows_of(p), find_pixel, p, {1, 0, 0, 0}, !left.none()};
}

bool shows_surroundings(const CameraInfo& camera) {
  return camera.role == Role::kEnvironment || camera.ball;
}

Result<std::vector<CameraRegion>> camera_regions(const CameraInfo& camera,
                                                 const Pose& world_from_camera) {
  std::vector<CameraRegion> out;
  if (camera.ball) {
    PENUMBRA_ASSIGN(region, ball_region(camera, world_from_camera));
    out.push_back(std::move(region));
    return out;
  }
  for (const Lens& lens : camera.lenses) out.push_back(lens_visibility(lens, camera.vignetting));
  if (out.empty()) out.push_back(plain_region(camera.projection, camera.vignetting));
  for (const CameraRegion& s : out) PENUMBRA_TRY(check_size(camera, s.width, s.height));
  return out;
}

std::optional<glm::dvec2> find_in_picture(std::span<const CameraRegion> regions,
                                          const glm::dvec3& direction) {
  std::optional<glm::dvec2> found;
  double best = -1;
  for (const CameraRegion& s : regions)
    if (const auto seen = s.find_pixel(direction); seen && seen->from_rim > best) {
      best = seen->from_rim;
      found = seen->px + glm::dvec2(s.x_px, s.y_px);
    }
  return found;
}

FramePixels cut_out(const FramePixels& picture, const CameraRegion& part) {
  return std::visit([&](const auto& image) -> FramePixels { return cut(image, part); }, picture);
}

}  // namespace penumbra::capture
