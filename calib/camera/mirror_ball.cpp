#include "calib/camera/mirror_ball.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#include <vector>

#include "core/conventions.h"

namespace penumbra::calib {

namespace {

double angle_between(const glm::dvec3& a, const glm::dvec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
}

}  // namespace

Result<MirrorBall> MirrorBall::at(const glm::dvec3& centre, double radius) {
  const double distance = glm::length(centre);
  if (!std::isfinite(distance) || !(radius > 0))
    return fail(ErrorCode::kInvalid, "mirror ball", "needs a finite centre and a positive radius");
  if (!(distance > radius))
    return fail(ErrorCode::kInvalid, "mirror ball",
                "contains the camera: its radius is larger than its distance");
  return MirrorBall(centre / distance, radius / distance);
}

// In the plane through the picture's axis the outline's nearest and farthest points part by the
// cone's whole angle.
Result<MirrorBall> MirrorBall::from_outline(const CameraModel& camera, const glm::dvec2& centre_px,
                                            double radius_px) {
  const glm::dvec2 off = centre_px - camera.principal_px;
  const double length = glm::length(off);
  const glm::dvec2 out = length > 0 ? off / length : glm::dvec2(1, 0);
  const auto near = direction_from_pixel(camera, centre_px - radius_px * out);
  const auto far = direction_from_pixel(camera, centre_px + radius_px * out);
  if (!(radius_px > 0) || !near || !far)
    return fail(ErrorCode::kInvalid, "mirror ball",
                "the ball's outline is partly outside the picture");
  return MirrorBall(glm::normalize(*near + *far), std::sin(angle_between(*near, *far) / 2));
}

double MirrorBall::angular_radius_rad() const {
  return std::asin(ratio_);
}

std::optional<MirrorBall::BallHit> MirrorBall::ray_from_light(const glm::dvec3& light) const {
  const double wanted = angle_between(-axis_, light);
  const double rim = kPi / 2 - std::asin(ratio_);  // the normal's angle on the outline
  if (wanted > kPi - std::asin(ratio_)) return std::nullopt;
  const auto ray_angle = [&](double t) {
    return std::atan2(ratio_ * std::sin(t), 1 - ratio_ * std::cos(t));
  };
  double t = std::min(wanted / 2, rim);
  constexpr int kNewtonSteps = 6;  // exact to 1e-7 for a camera that is not at the ball itself
  for (int i = 0; i < kNewtonSteps; ++i) {
    const double c = ratio_ * std::cos(t);
    const double slope = 2 + (c - ratio_ * ratio_) / (1 - 2 * c + ratio_ * ratio_);
    t = std::clamp(t - (2 * t + ray_angle(t) - wanted) / slope, 0., rim);
  }
  const double b = ray_angle(t);
  const glm::dvec3 unit = glm::normalize(light);
  glm::dvec3 side = unit - glm::dot(unit, axis_) * axis_;
  const double length = glm::length(side);
  side = length > 1e-12 ? side / length : glm::dvec3(0);
  return BallHit{axis_ * std::cos(b) + side * std::sin(b), 1 - t / rim};
}

Result<BallPlace> locate_ball(std::span<const BallOutline> outlines, double radius_m,
                              double sigma_px) {
  if (outlines.empty() || !(radius_m > 0))
    return fail(ErrorCode::kInvalid, "mirror ball", "needs an outline and a positive radius");
  struct CentreEstimate {
    glm::dvec3 centre;
    glm::dmat3 information;  // inverse of the covariance
  };
  std::vector<CentreEstimate> seen;
  glm::dmat3 all(0);
  glm::dvec3 sum(0);
  for (const BallOutline& o : outlines) {
    const auto ball = MirrorBall::from_outline(o.projection, o.centre_px, o.radius_px);
    if (!ball) return fail(ball.error().code, o.camera, ball.error().detail);
    const double distance = radius_m / std::sin(ball->angular_radius_rad());
    const double sideways = distance * ball->angular_radius_rad() / o.radius_px * sigma_px,
                 along = distance * sigma_px / o.radius_px;
    const glm::dvec3 d = o.world_from_camera.rotation * ball->direction();
    const glm::dmat3 towards = glm::outerProduct(d, d);
    seen.push_back({o.world_from_camera.translation + distance * d,
                    (glm::dmat3(1) - towards) * (1 / (sideways * sideways)) +
                        towards * (1 / (along * along))});
    all += seen.back().information;
    sum += seen.back().information * seen.back().centre;
  }
  const glm::dmat3 covariance = glm::inverse(all);
  const glm::dvec3 centre = covariance * sum;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const glm::dvec3 off = seen[i].centre - centre;
    constexpr double kMaxSigmas = 5;
    if (glm::dot(off, seen[i].information * off) > kMaxSigmas * kMaxSigmas)
      return fail(ErrorCode::kUndetermined, outlines[i].camera,
                  fmt::format("sees the ball {:.0f} mm from where all cameras together see it: "
                              "check the circles, the radius and the cameras' poses",
                              1000 * glm::length(off)));
  }
  return BallPlace{
      centre,
      {std::sqrt(covariance[0][0]), std::sqrt(covariance[1][1]), std::sqrt(covariance[2][2])}};
}

}  // namespace penumbra::calib
