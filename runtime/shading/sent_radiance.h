// What an object sends back to what it shades, as seen from outside.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// A third of the area of the triangles that meet in each vertex, square metres.
std::vector<float> vertex_areas(const prt::Mesh& mesh);

/// Mean exit radiance of the surface that faces a direction, weighted by projected area.
class SentRadiance {
 public:
  /// in: areas of the vertices; relit, irradiance/pi of the vertices, a plane for each colour
  SentRadiance(const prt::Mesh& mesh, std::span<const float> areas, std::span<const float> relit);

  /// in: from the object's middle to what is lit, mesh frame, of any length but zero
  Rgb towards(const glm::vec3& to) const;

 private:
  // Sums of exit radiance and of 1 over the surface, each times the cosine to a direction.
  IrradianceSh sent_, facing_;
  float min_facing_ = 0;
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
