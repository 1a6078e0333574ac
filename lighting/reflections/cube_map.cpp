#include "lighting/reflections/cube_map.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace penumbra::lighting {

CubeMap::CubeMap(int size) {
  for (Image<Rgb>& face : faces) face = Image<Rgb>(size, size);
}

glm::vec3 cube_direction(int face, float s, float t) {
  const float a = 2 * s - 1, b = 2 * t - 1;
  const std::array<glm::vec3, 6> along{
      {{1, -b, -a}, {-1, -b, a}, {a, 1, b}, {a, -1, -b}, {a, -b, 1}, {-a, -b, -1}}};
  return glm::normalize(along[static_cast<std::size_t>(face)]);
}

CubePlace cube_place(const glm::vec3& d) {
  const glm::vec3 size = glm::abs(d);
  const auto place = [](int face, float s, float t, float largest) {
    return CubePlace{face, .5f * (s / largest + 1), .5f * (t / largest + 1)};
  };
  if (size.x >= size.y && size.x >= size.z)
    return d.x > 0 ? place(0, -d.z, -d.y, size.x) : place(1, d.z, -d.y, size.x);
  if (size.y >= size.z) return d.y > 0 ? place(2, d.x, d.z, size.y) : place(3, d.x, -d.z, size.y);
  return d.z > 0 ? place(4, d.x, -d.y, size.z) : place(5, -d.x, -d.y, size.z);
}

Rgb sample(const CubeMap& cube, const glm::vec3& direction) {
  const CubePlace at = cube_place(direction);
  const Image<Rgb>& face = cube.faces[static_cast<std::size_t>(at.face)];
  const int last = cube.size() - 1;
  const auto split = [&](float where) {
    const float x =
        std::clamp(where * static_cast<float>(cube.size()) - .5f, 0.f, static_cast<float>(last));
    const int i = std::min(static_cast<int>(x), last);
    return std::pair{i, x - static_cast<float>(i)};
  };
  const auto [x, fx] = split(at.s);
  const auto [y, fy] = split(at.t);
  const int x1 = std::min(x + 1, last), y1 = std::min(y + 1, last);
  return (face.at(x, y) * (1 - fx) + face.at(x1, y) * fx) * (1 - fy) +
         (face.at(x, y1) * (1 - fx) + face.at(x1, y1) * fx) * fy;
}

CubeMap halved(const CubeMap& cube) {
  const int size = cube.size() / 2;
  CubeMap out(size);
  for (std::size_t f = 0; f < out.faces.size(); ++f)
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x) {
        const Image<Rgb>& in = cube.faces[f];
        out.faces[f].at(x, y) = (in.at(2 * x, 2 * y) + in.at(2 * x + 1, 2 * y) +
                                 in.at(2 * x, 2 * y + 1) + in.at(2 * x + 1, 2 * y + 1)) *
                                .25f;
      }
  return out;
}

}  // namespace penumbra::lighting
