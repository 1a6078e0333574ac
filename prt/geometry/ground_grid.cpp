#include <algorithm>
#include <cmath>

#include "prt/geometry/ground_grid.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"

namespace penumbra::prt {

glm::vec2 GroundGrid::position(glm::vec2 uv) const {
  const auto axis = [&](float u) {
    const float w = 2 * u - 1;
    return half_extent * w / (1 + kStretch - kStretch * std::abs(w));
  };
  return centre + glm::vec2(axis(uv.x), axis(uv.y));
}

glm::vec2 GroundGrid::uv(glm::vec2 position) const {
  const auto axis = [&](float metres) {
    const float p = metres / half_extent;
    return .5f + .5f * (1 + kStretch) * p / (1 + kStretch * std::abs(p));
  };
  return {axis(position.x - centre.x), axis(position.y - centre.y)};
}

GroundGrid fit_ground_grid(const Mesh& mesh, float plane_height, int size) {
  const glm::vec3 centre = bounds_of(mesh).centre();
  const float radius = std::max(radius_around(mesh, centre), 1e-6f);
  return {size, {centre.x, centre.z}, 5 * radius, plane_height};
}

}  // namespace penumbra::prt
