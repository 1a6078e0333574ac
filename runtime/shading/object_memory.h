// What an object takes in memory.
// threads: reentrant
#pragma once

#include <cstddef>

#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {

/// Bytes that a stage keeps of the mesh and the bake of an object which keeps its form. Textures,
/// edges of one light's shadows, and what is built over the mesh to trace it, come on top. Copies
/// share all but the mesh.
struct ObjectMemory {
  std::size_t mesh = 0;     // places, normals, albedo, triangles
  std::size_t surface = 0;  // patterns that relight it
  std::size_t ground = 0;   // patterns that relight its receiver
  std::size_t shadows = 0;  // the receiver's deficit, for shadows that meet
  std::size_t visibility = 0;
  std::size_t bytes_a_light = 0;  // beside that: a distant light's map on one plane, and vertices

  std::size_t without_lights() const { return mesh + surface + ground + shadows + visibility; }
};

/// map_size: texels along a side of a light's shadow map; 0: none
ObjectMemory memory_of(const prt::BakedObject& baked, const RelightBases& bases, int map_size);

}  // namespace penumbra::runtime
