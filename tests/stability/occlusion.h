// Reads a light's shadow as the compositor does.
#pragma once

#include <cmath>

#include "shadows/shadows.h"

namespace penumbra::test {

/// Fraction that is taken at a place of the plane, bilinear; 0 outside the map.
inline double taken_at(const shadows::ShadowMap& s, const glm::dvec3& place) {
  const glm::dvec3 at = s.world_from_map.inverse() * place / double(s.cell_m);
  const int x = static_cast<int>(std::floor(at.x)), y = static_cast<int>(std::floor(at.z));
  if (x < 0 || y < 0 || x + 1 >= s.virtual_occlusion.width() ||
      y + 1 >= s.virtual_occlusion.height())
    return 0;
  const double u = at.x - x, v = at.z - y;
  const auto t = [&](int i, int j) { return double(s.virtual_occlusion.at(x + i, y + j)); };
  return (1 - v) * ((1 - u) * t(0, 0) + u * t(1, 0)) + v * ((1 - u) * t(0, 1) + u * t(1, 1));
}

}  // namespace penumbra::test
