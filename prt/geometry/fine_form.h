// A mesh of many vertices that is drawn, and one of few by which it is lit.
// threads: reentrant
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// How a mesh is drawn that is too fine to be lit at each vertex, in the frame of the coarse one.
struct FineForm {
  Mesh mesh;
  std::shared_ptr<const SurfaceMaterials> surface{};  // null: its albedo is all
  /// The place of the coarse mesh whose light a vertex gets: (1-u-v) a + u b + v c.
  struct LitAt {
    std::array<std::uint32_t, 3> corners;
    float u, v;
  };
  std::vector<LitAt> lit_at;  // by vertex
};

/// What the coarse mesh's vertices have, at those of the fine one.
template <class Value>
std::vector<Value> at_fine_vertices(const FineForm& fine, const std::vector<Value>& coarse) {
  std::vector<Value> out;
  out.reserve(fine.lit_at.size());
  for (const auto& [corners, u, v] : fine.lit_at)
    out.push_back(coarse[corners[0]] * (1 - u - v) + coarse[corners[1]] * u +
                  coarse[corners[2]] * v);
  return out;
}

struct Simplified {
  Mesh mesh;
  std::vector<std::uint32_t> from;  // by vertex: which one of the given mesh it is
  float error = 0;                  // of the mesh's largest extent
};
/// Nearly the same form by some of its vertices, about `max_vertices`. Where holes and seams keep
/// it from getting there, parts are merged.
/// in: more vertices than that
/// source: Garland & Heckbert 1997, by meshoptimizer
Simplified simplify(const Mesh& mesh, std::size_t max_vertices);
/// Materials of some of a mesh's vertices.
SurfaceMaterials picked(const SurfaceMaterials& surface, std::span<const std::uint32_t> from);

}  // namespace penumbra::prt
#pragma GCC visibility pop
