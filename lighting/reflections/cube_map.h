// Six square pictures around a point.
// threads: plain values; free functions reentrant
#pragma once

#include <array>
#include <glm/vec3.hpp>
#include <utility>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Faces in OpenGL's order, +x -x +y -y +z -z, each with OpenGL's own axes; directions are the
/// world's.
/// source: OpenGL ES 3.1, table 8.18
struct CubeMap {
  std::array<Image<Rgb>, 6> faces;

  CubeMap() = default;
  explicit CubeMap(int size);
  int size() const { return faces[0].width(); }
  bool empty() const { return faces[0].empty(); }
};

/// Unit direction of a place on a face, 0..1 from its first column and row.
glm::vec3 cube_direction(int face, float s, float t);
/// The face that a direction meets, and where.
struct CubePlace {
  int face;
  float s, t;
};
CubePlace cube_place(const glm::vec3& direction);
/// Between the four nearest texels of a face; at its border those of the border.
Rgb sample(const CubeMap& cube, const glm::vec3& direction);
/// Half the size, each texel the mean of four.
CubeMap halved(const CubeMap& cube);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
