// A place on something real that a ray meets: the real mesh or a plane.
// threads: reentrant
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>

#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "prt/rays/rays.h"

namespace penumbra::runtime {

inline constexpr float kLevelRay = 1e-3f;   // a ray that falls less never meets a plane
inline constexpr double kOnPlane_m = 1e-3;  // what is nearer to a plane lies on it

struct RealPoint {
  static constexpr std::int16_t kMesh = -1;

  std::int16_t plane = kMesh;  // its number in the scene
  bool back = false;           // of the mesh, seen from behind: black, as in the bake
  std::uint32_t vertex = 0;    // of the real mesh, the nearest
  glm::vec3 on_plane{0};       // world, metres
};

/// Distance in metres to the first plane that a ray meets from its front, and the place on it; the
/// largest float without one.
/// in: except, the number of a plane that does not count, or RealPoint::kMesh
float meet_planes(std::span<const prt::Plane> planes, const glm::vec3& from,
                  const glm::vec3& direction, int except, RealPoint& met);

struct MetReal {
  RealPoint point;
  float distance;  // metres
};
/// The first real thing that a ray of a packet meets, of the mesh as `by_mesh` has it; nothing
/// where that is the sky.
/// in: except, the number of a plane that does not count, or RealPoint::kMesh
std::optional<MetReal> meet_real(std::span<const prt::Plane> planes, const prt::Mesh& mesh,
                                 const prt::RayWorld::Rays& rays,
                                 const prt::RayWorld::Hits& by_mesh, int lane, int except);
/// The plane on which a thing stands at `foot` with `up` as its normal, or RealPoint::kMesh.
int plane_at(std::span<const prt::Plane> planes, const glm::dvec3& foot, const glm::dvec3& up);

}  // namespace penumbra::runtime
