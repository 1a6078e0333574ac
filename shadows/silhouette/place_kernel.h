// Loops over all vertices of a mesh as a light, or a plane under it, sees them.
#pragma once

#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <span>

#pragma GCC visibility push(default)
namespace penumbra::shadows {

/// out = turn * p + shift.
struct AffineTransform {
  glm::mat3 turn;
  glm::vec3 shift;
};

/// Directions of a light and their mean; all of them lie within `reach` of `middle`.
struct DirectionSet {
  std::span<const glm::vec3> directions;
  glm::vec3 middle, mean;
  float reach;
};
/// out = the mean over the directions of max(n.w, 0), in the normals' frame. Where no direction is
/// behind the surface it is a product with their mean.
/// in: unit normals; at least one direction.
/// threads: reentrant
void mean_cosines(std::span<const glm::vec3> normals, const DirectionSet& light,
                  std::span<float> out);

/// Bounds over x and z of what is on or above a plane, y up: of its feet, and of its shadows, which
/// go from p.y * reach_low to p.y * reach_high beyond them.
struct Footprint {
  glm::vec2 low{1e30f}, high{-1e30f};
  glm::vec2 shadow_low{1e30f}, shadow_high{-1e30f};
  bool below = false;  // something is lower than -near_m; what is between counts as on the plane
};
struct Reach {
  glm::vec2 low, high;  // metres for each metre of height
};
/// threads: reentrant
Footprint footprint_of(std::span<const glm::vec3> positions, const AffineTransform& plane_from_mesh,
                       const Reach& reach, float near_m);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
