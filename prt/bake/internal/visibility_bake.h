// Finds what the vertices of a mesh see past it.
// threads: in one pass reentrant for different vertices
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <vector>

#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"
#include "prt/transfer/visibility_map.h"

namespace penumbra::prt {

/// Of one vertex, by block the bits of its eight by eight finer cells, refined or not.
using OpenCells = std::array<std::uint64_t, VisibilityMap::kBlocks * VisibilityMap::kBlocks>;

/// Two passes, each over all vertices: one ray for each of 256 wide cells, then one for each of the
/// sixteen finer ones of those in which an edge may be. Those beside an edge are asked, and those
/// in which a vertex around sees one: what is thin hides between the wide rays of one vertex, not
/// of all around it. From there edges are followed from cell to cell.
class VisibilityBake {
 public:
  static constexpr int kWideCells = 16;                                         // along a side
  static constexpr int kPackets = kWideCells * kWideCells / RayScene::kPacket;  // a vertex
  using Rows = std::array<std::uint16_t, kWideCells>;  // bit by wide cell of a row

  /// Both must outlive it.
  /// in: the mesh moved to the origin and scaled to radius one, as `scene` has it; finite normals
  VisibilityBake(const Mesh& mesh, const RayScene& scene);

  /// First pass, whose rays the bake traces itself, as it wants to know what they hit: directions
  /// for a block of four by four wide cells, and, once for each block, which are blocked.
  static void wide_rays(const HemiOctFrame& frame, int block, RayScene::RayPacket& packet);
  void keep_wide(std::size_t vertex, int block, std::uint32_t blocked);
  /// Second pass, once a vertex.
  OpenCells refine(std::size_t vertex);

  /// After both passes; take() once.
  std::uint64_t rays() const { return rays_; }
  VisibilityMap take();

 private:
  Rows edges_of_others(std::size_t vertex) const;
  void keep(std::size_t vertex, const OpenCells& open);

  const Mesh& mesh_;
  const RayScene& scene_;
  std::vector<std::uint32_t> place_;                // vertices of one position are one place
  std::vector<std::vector<std::uint32_t>> around_;  // by place
  std::vector<Rows> wide_;
  std::vector<std::vector<std::uint64_t>> fine_;  // by vertex, its refined blocks
  VisibilityMap visibility_;
  std::atomic<std::uint64_t> rays_ = 0;
};

}  // namespace penumbra::prt
