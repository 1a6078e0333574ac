// A white wall with a leaning edge, which shows how soft and how noisy an inserted thing is drawn.
#pragma once

#include <cmath>
#include <glm/vec3.hpp>
#include <utility>

#include "prt/prt.h"

namespace penumbra::test {

/// 2 m before a camera at the origin that looks along -z: everything to the right of an edge
/// through the picture's middle, which leans by `lean` radians.
inline prt::BakedObject leaning_wall(double lean) {
  const auto at = [&](double along, double across) {
    return glm::vec3(std::cos(lean) * across + std::sin(lean) * along,
                     -std::sin(lean) * across + std::cos(lean) * along, -2);
  };
  prt::Mesh m;
  m.positions = {at(-9, 0), at(-9, 9), at(9, 9), at(9, 0)};
  m.normals.assign(4, {0, 0, 1});
  m.albedo.assign(4, {1, 1, 1});
  m.triangles = {{0, 1, 2}, {0, 2, 3}};
  prt::BakeOptions options;
  options.bands = 3;
  options.bounces = 0;
  options.rays = 64;
  return *prt::bake(std::move(m), options);
}

}  // namespace penumbra::test
