#include <algorithm>
#include <cmath>

#include "prt/prt.h"

namespace penumbra::prt {

namespace {

float stretch(const GroundGrid& g) { return std::asinh(g.half_extent / g.core); }

}  // namespace

glm::vec2 GroundGrid::position(glm::vec2 uv) const {
  const float k = stretch(*this);
  return {centre.x + core * std::sinh(k * (2 * uv.x - 1)), centre.y + core * std::sinh(k * (2 * uv.y - 1))};
}

glm::vec2 GroundGrid::uv(glm::vec2 p) const {
  const float k = stretch(*this);
  return {.5f + .5f * std::asinh((p.x - centre.x) / core) / k,
          .5f + .5f * std::asinh((p.y - centre.y) / core) / k};
}

GroundGrid fit_ground_grid(const Mesh& mesh, float plane_height, int size) {
  const glm::vec3 centre = bounds_of(mesh).centre();
  const float radius = std::max(radius_around(mesh, centre), 1e-6f);
  return {size, {centre.x, centre.z}, 5 * radius, .6f * radius, plane_height};
}

}  // namespace penumbra::prt
