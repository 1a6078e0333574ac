// The plane under an object, as far as the object's shadow reaches on it.
// threads: plain values
#pragma once

#include <glm/vec2.hpp>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// Sample points of a receiving plane around an object: size x size texels, dense near the centre.
/// Along each axis, with p in -1..1 the position in half extents and w in -1..1 the texture
/// coordinate 2u - 1:
///   w = (1 + k) p / (1 + k |p|),  p = w / (1 + k - k |w|),  k = 3
/// so the centre is sampled 1 + k times as densely as an even grid and the rim 1/(1 + k) times.
struct GroundGrid {
  static constexpr float kStretch = 3;
  int size = 128;
  glm::vec2 centre{0, 0};  // x, z in the bake frame, metres
  float half_extent = 1;   // metres from the centre to the rim
  float height = 0;        // y of the plane in the bake frame

  glm::vec2 position(glm::vec2 uv) const;  // x, z
  glm::vec2 uv(glm::vec2 position) const;  // outside 0..1 beyond the rim
};
struct Receiver {
  GroundGrid grid;
  Rgb albedo;  // its reflection lights the object; 0 = none
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
