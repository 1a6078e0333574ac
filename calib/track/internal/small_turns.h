// Private to track: rotations as turns about the world's axes, in radians.
// threads: reentrant
#pragma once

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <glm/vec3.hpp>

namespace penumbra::calib {

inline glm::dquat rotation_by(const glm::dvec3& turn) {
  const double angle = glm::length(turn);
  if (angle < 1e-12) return glm::normalize(glm::dquat(1, turn.x / 2, turn.y / 2, turn.z / 2));
  return glm::angleAxis(angle, turn / angle);
}

/// The short way.
inline glm::dvec3 turn_of(glm::dquat q) {
  if (q.w < 0) q = -q;
  const glm::dvec3 axis(q.x, q.y, q.z);
  const double sine = glm::length(axis);
  if (sine < 1e-12) return 2. * axis;
  return axis * (2 * std::atan2(sine, q.w) / sine);
}

}  // namespace penumbra::calib
