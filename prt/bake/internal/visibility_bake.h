// Finds what the vertices of a mesh see past it.
#pragma once

#include <functional>

#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"
#include "prt/transfer/visibility_map.h"

namespace penumbra::prt {

/// First every vertex is traced, then all are refined.
class VisibilityBake {
 public:
  // A vertex, but finer ones
  static constexpr int kRays = VisibilityMap::kCells * VisibilityMap::kCells;
  /// Both must outlive it.
  /// in: the mesh moved to the origin and scaled to radius one, as `scene` has it; finite normals
  VisibilityBake(const Mesh& mesh, const RayScene& scene);

  /// threads: reentrant for different vertices
  void trace(std::size_t vertex);
  /// Progress in fractions that add up to one.
  /// threads: parallel inside, and so is `progress` called
  void refine(const std::function<void(double)>& progress);
  VisibilityMap take() { return std::move(visibility_); }

 private:
  std::uint64_t edges_seen_by(std::size_t other, std::size_t vertex) const;
  std::uint64_t own_edges(std::size_t vertex) const;

  const Mesh& mesh_;
  const RayScene& scene_;
  VisibilityMap visibility_;
};

}  // namespace penumbra::prt
