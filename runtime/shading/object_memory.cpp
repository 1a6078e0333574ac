#include "runtime/shading/object_memory.h"

#include "prt/transfer/visibility_map.h"

namespace penumbra::runtime {

namespace {

template <class Vector>
std::size_t bytes_of(const Vector& values) {
  return values.size() * sizeof(values[0]);
}

}  // namespace

ObjectMemory memory_of(const prt::BakedObject& baked, const RelightBases& bases, int map_size) {
  const prt::Mesh& mesh = baked.mesh;
  const prt::Transfer& deficit = baked.ground_deficit;  // its first channel is kept
  const prt::VisibilityMap& visibility = baked.visibility;
  const auto side = static_cast<std::size_t>(map_size);
  return {
      .mesh = bytes_of(mesh.positions) + bytes_of(mesh.normals) + bytes_of(mesh.albedo) +
              bytes_of(mesh.triangles),
      .surface = bases.surface.bytes(),
      .ground = bases.ground.bytes(),
      .shadows = bytes_of(deficit.values) / static_cast<std::size_t>(deficit.channels),
      // With what a look-up asks first.
      .visibility = bytes_of(visibility.open) + bytes_of(visibility.fine) +
                    bytes_of(visibility.refined) +
                    visibility.refined.size() * sizeof(prt::VisibilityHead),
      .bytes_a_light = (side * side + baked.transfer.points) * sizeof(float),
  };
}

}  // namespace penumbra::runtime
