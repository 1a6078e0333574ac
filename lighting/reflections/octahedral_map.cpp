#include "lighting/reflections/octahedral_map.h"

#include <cmath>
#include <glm/geometric.hpp>

namespace penumbra::lighting {

namespace {

// The lower half's triangles lie outside of the upper half's square, mirrored at its sides.
glm::vec2 folded(const glm::vec2& p) {
  return {std::copysign(1 - std::abs(p.y), p.x), std::copysign(1 - std::abs(p.x), p.y)};
}

}  // namespace

glm::vec3 octahedral_direction(const glm::vec2& place) {
  glm::vec2 p = 2.f * place - 1.f;
  const float up = 1 - std::abs(p.x) - std::abs(p.y);
  if (up < 0) p = folded(p);
  return glm::normalize(glm::vec3(p.x, up, p.y));
}

glm::vec2 octahedral_place(const glm::vec3& d) {
  const float sum = std::abs(d.x) + std::abs(d.y) + std::abs(d.z);
  glm::vec2 p(d.x / sum, d.z / sum);
  if (d.y < 0) p = folded(p);
  return .5f * p + .5f;
}

glm::ivec2 octahedral_texel(int x, int y, int size) {
  if (x < 0 || x >= size) y = size - 1 - y, x = x < 0 ? 0 : size - 1;
  if (y < 0 || y >= size) x = size - 1 - x, y = y < 0 ? 0 : size - 1;
  return {x, y};
}

Rgb sample_octahedral(const Image<Rgb>& picture, const glm::vec3& direction) {
  const int size = picture.width();
  const glm::vec2 at = octahedral_place(direction) * static_cast<float>(size) - .5f;
  const int x = static_cast<int>(std::floor(at.x)), y = static_cast<int>(std::floor(at.y));
  const float fx = at.x - static_cast<float>(x), fy = at.y - static_cast<float>(y);
  if (x >= 0 && y >= 0 && x + 1 < size && y + 1 < size)
    return (picture.at(x, y) * (1 - fx) + picture.at(x + 1, y) * fx) * (1 - fy) +
           (picture.at(x, y + 1) * (1 - fx) + picture.at(x + 1, y + 1) * fx) * fy;
  const auto texel = [&](int i, int j) {
    const glm::ivec2 t = octahedral_texel(i, j, size);
    return picture.at(t.x, t.y);
  };
  return (texel(x, y) * (1 - fx) + texel(x + 1, y) * fx) * (1 - fy) +
         (texel(x, y + 1) * (1 - fx) + texel(x + 1, y + 1) * fx) * fy;
}

}  // namespace penumbra::lighting
