// A light whose shadow on an object is drawn finer than the object's mesh.
// threads: plain values
#pragma once

#include <glm/vec3.hpp>
#include <span>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::compositor {

/// A source whose shadow's edges on an object are drawn finer than the object's mesh. The light at
/// vertices holds radiance * cosine of it. In its place is drawn radiance * open * clamp(lit, 0, 1)
/// of interpolated values.
struct EdgedLight {
  Rgb radiance;                   // of a white surface that faces the source, nothing in its way
  std::span<const float> cosine;  // by vertex, what arrives
  std::span<const float> open;    // with nothing in its way
  std::span<const float> lit;     // visible fraction; beyond 0..1 by the distance from an edge
  glm::dvec3 direction{0};        // to the source's middle, world; 0: not told
};

}  // namespace penumbra::compositor
#pragma GCC visibility pop
