// Rigid transforms, named target-from-source: `world_from_camera * point_in_camera`.
// threads: plain values
#pragma once

#include <glm/gtc/quaternion.hpp>
#include <glm/mat3x3.hpp>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>

#pragma GCC visibility push(default)
namespace penumbra {

struct Pose {
  glm::dquat rotation{1, 0, 0, 0};  // w, x, y, z in GLM's constructor; files write x, y, z, w
  glm::dvec3 translation{0, 0, 0};  // metres

  glm::dvec3 operator*(const glm::dvec3& point) const { return rotation * point + translation; }
  Pose operator*(const Pose& other) const {
    return {rotation * other.rotation, rotation * other.translation + translation};
  }
  Pose inverse() const {
    const glm::dquat back = glm::conjugate(rotation);
    return {back, -(back * translation)};
  }
  glm::dmat3 rotation_matrix() const { return glm::mat3_cast(rotation); }
  glm::dmat4 matrix() const {
    glm::dmat4 m = glm::mat4_cast(rotation);
    m[3] = glm::dvec4(translation, 1);
    return m;
  }
  friend bool operator==(const Pose&, const Pose&) = default;
};

}  // namespace penumbra
#pragma GCC visibility pop
