// What a mirror ball shows: the law of reflection, for pictures that tests make.
#pragma once

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "calib/camera/mirror_ball.h"

namespace penumbra::test {

/// Where the light comes from that this ray (any length) shows; nothing beside the ball.
inline std::optional<glm::dvec3> reflected(const calib::MirrorBall& ball, const glm::dvec3& ray) {
  const double ratio = std::sin(ball.angular_radius_rad());
  const glm::dvec3 v = glm::normalize(ray);
  const double along = glm::dot(v, ball.direction());
  const double left = along * along - (1 - ratio * ratio);
  if (along <= 0 || left < 0) return std::nullopt;
  const glm::dvec3 normal = ((along - std::sqrt(left)) * v - ball.direction()) / ratio;
  return v - 2 * glm::dot(v, normal) * normal;
}

}  // namespace penumbra::test
