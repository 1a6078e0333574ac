// Light at surfaces that face all around, to compare maps by.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "core/conventions.h"
#include "core/image.h"

namespace penumbra::test {

/// Of a lat-long map, at 32 normals.
inline std::vector<glm::dvec3> irradiances(const Image<Rgb>& map) {
  constexpr int kNormals = 32;
  constexpr double kGoldenAngle = 2.399963;
  const int width = map.width(), height = map.height();
  std::vector<glm::dvec3> out;
  for (int k = 0; k < kNormals; ++k) {
    const double y = 1 - (2 * k + 1) / double(kNormals), r = std::sqrt(1 - y * y);
    const glm::dvec3 normal(r * std::cos(k * kGoldenAngle), y, r * std::sin(k * kGoldenAngle));
    glm::dvec3& sum = out.emplace_back(0);
    for (int j = 0; j < height; ++j)
      for (int i = 0; i < width; ++i) {
        const double cosine = glm::dot(normal, latlong_direction(i + .5, j + .5, width, height));
        if (cosine <= 0) continue;
        const Rgb& p = map.at(i, j);
        sum += glm::dvec3(p.r, p.g, p.b) * cosine * latlong_solid_angle(j, width, height);
      }
  }
  return out;
}

/// The largest of all normals and channels, relative.
inline double irradiance_error(const Image<Rgb>& map, const Image<Rgb>& truth) {
  const auto got = irradiances(map), expected = irradiances(truth);
  double worst = 0;
  for (std::size_t i = 0; i < got.size(); ++i)
    for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(got[i][c] / expected[i][c] - 1));
  return worst;
}

}  // namespace penumbra::test
