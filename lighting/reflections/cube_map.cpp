#include "lighting/reflections/cube_map.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>

#include "core/conventions.h"

namespace penumbra::lighting {

namespace {

struct CubeTexel {
  int face, row, column;
  std::size_t index(int size) const {
    return static_cast<std::size_t>((face * size + row) * size + column);
  }
};

CubeTexel texel_towards(const glm::dvec3& d, int size) {
  const glm::dvec3 length = glm::abs(d);
  int face = 0;
  double s = 0, t = 0, along = 1;
  if (length.x >= length.y && length.x >= length.z) {
    face = d.x > 0 ? 0 : 1, along = length.x, s = d.x > 0 ? -d.z : d.z, t = -d.y;
  } else if (length.y >= length.z) {
    face = d.y > 0 ? 2 : 3, along = length.y, s = d.x, t = d.y > 0 ? d.z : -d.z;
  } else {
    face = d.z > 0 ? 4 : 5, along = length.z, s = d.z > 0 ? d.x : -d.x, t = -d.y;
  }
  const auto place = [&](double v) {
    return std::clamp(static_cast<int>((v / along + 1) / 2 * size), 0, size - 1);
  };
  return {face, place(t), place(s)};
}

glm::dvec3 direction_of(const CubeTexel& at, int size) {
  const double s = 2 * (at.column + .5) / size - 1, t = 2 * (at.row + .5) / size - 1;
  const glm::dvec3 directions[] = {{1, -t, -s}, {-1, -t, s}, {s, 1, t},
                                   {s, -1, -t}, {s, -t, 1},  {-s, -t, -1}};
  return glm::normalize(directions[at.face]);
}

}  // namespace

CubeMap::CubeMap(int map_width, int map_height, int size) : width_(map_width), height_(map_height) {
  const auto edge = static_cast<std::size_t>(size);
  inverse_weights_.resize(6 * edge * edge);
  for (int y = 0; y < height_; ++y) {
    row_weights_.push_back(static_cast<float>(std::sin(kPi * (y + .5) / height_)));
    for (int x = 0; x < width_; ++x) {
      const glm::dvec3 d = latlong_direction(x + .5, y + .5, width_, height_);
      const std::size_t i = texel_towards(d, size).index(size);
      texels_.push_back(static_cast<std::uint32_t>(i));
      inverse_weights_[i] += row_weights_.back();
    }
  }
  for (int face = 0; face < 6; ++face)
    for (int row = 0; row < size; ++row)
      for (int column = 0; column < size; ++column) {
        const CubeTexel at{face, row, column};
        float& weight = inverse_weights_[at.index(size)];
        if (weight > 0) {
          weight = 1 / weight;
          continue;
        }
        const glm::dvec2 p = latlong_pixel(direction_of(at, size), width_, height_);
        empty_.emplace_back(at.index(size),
                            glm::ivec2(std::clamp(static_cast<int>(p.x), 0, width_ - 1),
                                       std::clamp(static_cast<int>(p.y), 0, height_ - 1)));
      }
}

std::vector<Rgb> CubeMap::apply(const Image<Rgb>& map) const {
  std::vector<Rgb> out(inverse_weights_.size());
  const std::uint32_t* texel = texels_.data();
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x)
      out[*texel++] += row_weights_[static_cast<std::size_t>(y)] * map.at(x, y);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = out[i] * inverse_weights_[i];
  for (const auto& [i, pixel] : empty_) out[i] = map.at(pixel.x, pixel.y);
  return out;
}

}  // namespace penumbra::lighting
