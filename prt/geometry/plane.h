// An infinite real plane.
// threads: plain values; several may call `texture` at a time
#pragma once

#include <functional>
#include <glm/vec3.hpp>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// An infinite real plane. `texture` scales the albedo by position where given.
struct Plane {
  glm::dvec3 point{0, 0, 0}, normal{0, 1, 0};
  Rgb albedo{.5f, .5f, .5f};
  std::function<Rgb(const glm::dvec3&)> texture;
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
