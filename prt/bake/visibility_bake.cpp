#include "prt/bake/internal/visibility_bake.h"

#include <algorithm>
#include <bit>
#include <glm/geometric.hpp>

#include "core/threads/parallel.h"
#include "prt/bake/bake_rules.h"

namespace penumbra::prt {

namespace {

constexpr int kBlocks = VisibilityMap::kBlocks, kAllBlocks = kBlocks * kBlocks;
constexpr std::uint32_t kAllOpen = 0xffff;  // of a block
constexpr std::size_t kAtOnce = 64;         // vertices

// Rays of one vertex.
class Eye {
 public:
  Eye(const RayScene& scene, const Mesh& mesh, std::size_t vertex)
      : scene_(scene),
        frame_(HemiOctFrame::of(vertex, mesh.normals[vertex])),
        origin_(mesh.positions[vertex] + kRayNear * mesh.normals[vertex]) {}
  /// Bit by cell of four by four from (x, y).
  std::uint32_t open(int x, int y, int cells) const {
    static_assert(RayScene::kPacket == 16);
    RayScene::RayPacket packet;
    for (int i = 0; i < RayScene::kPacket; ++i) {
      const glm::vec3 d = frame_.direction(x + i % 4, y + i / 4, cells);
      packet.x[i] = d.x, packet.y[i] = d.y, packet.z[i] = d.z;
    }
    return ~scene_.occluded(origin_, kRayNear, packet) & kAllOpen;
  }
  /// Bit by cell of eight by eight.
  std::uint64_t fine(int block) const {
    const int x = 8 * (block % kBlocks), y = 8 * (block / kBlocks);
    std::uint64_t out = 0;
    for (const int down : {0, 4})
      for (const int right : {0, 4}) {
        std::uint64_t rows = open(x + right, y + down, VisibilityMap::kFineCells);
        for (int row = down; row < down + 4; ++row, rows >>= 4)
          out |= (rows & 15) << (8 * row + right);
      }
    return out;
  }

 private:
  const RayScene& scene_;
  HemiOctFrame frame_;
  glm::vec3 origin_;
};

// By place of positions the vertices that share a triangle with one there, each once: seams are no
// rims.
std::vector<std::vector<std::uint32_t>> neighbours(const Mesh& mesh,
                                                   std::span<const std::uint32_t> place) {
  std::vector<std::vector<std::uint32_t>> out(mesh.positions.size());
  for (const auto& [a, b, c] : mesh.triangles) {
    for (const std::uint32_t v : {b, c}) out[place[a]].push_back(v);
    for (const std::uint32_t v : {c, a}) out[place[b]].push_back(v);
    for (const std::uint32_t v : {a, b}) out[place[c]].push_back(v);
  }
  for (auto& at_place : out) {
    std::ranges::sort(at_place);
    at_place.erase(std::ranges::unique(at_place).begin(), at_place.end());
  }
  return out;
}

}  // namespace

VisibilityBake::VisibilityBake(const Mesh& mesh, const RayScene& scene)
    : mesh_(mesh), scene_(scene), visibility_(mesh.positions.size()) {}

void VisibilityBake::trace(std::size_t vertex) {
  const Eye eye(scene_, mesh_, vertex);
  for (int block = 0; block < kAllBlocks; ++block) {
    const std::uint32_t bits =
        eye.open(4 * (block % kBlocks), 4 * (block / kBlocks), VisibilityMap::kCells);
    visibility_.open[vertex * VisibilityMap::kWords + static_cast<std::size_t>(block / 2)] |=
        bits << 16 * (block % 2);
  }
}

// Bit by block.
std::uint64_t VisibilityBake::own_edges(std::size_t vertex) const {
  std::uint64_t out = 0;
  for (int block = 0; block < kAllBlocks; ++block)
    if (const std::uint32_t bits = visibility_.block(vertex, block); bits != 0 && bits != kAllOpen)
      out |= std::uint64_t{1} << block;
  return out;
}

// Bit by block of `vertex`, in the directions in which another one sees an edge.
std::uint64_t VisibilityBake::edges_seen_by(std::size_t other, std::size_t vertex) const {
  const HemiOctFrame from = HemiOctFrame::of(other, mesh_.normals[other]),
                     to = HemiOctFrame::of(vertex, mesh_.normals[vertex]);
  std::uint64_t out = 0;
  for (std::uint64_t left = own_edges(other); left != 0; left &= left - 1) {
    const int block = std::countr_zero(left);
    std::uint32_t few = visibility_.block(other, block);
    if (std::popcount(few) > 8) few ^= kAllOpen;
    for (; few != 0; few &= few - 1) {
      const int i = std::countr_zero(few);
      const glm::vec3 d = from.direction(4 * (block % kBlocks) + i % 4,
                                         4 * (block / kBlocks) + i / 4, VisibilityMap::kCells);
      if (!(glm::dot(d, to.normal) > 0)) continue;
      const glm::ivec2 at = to.cell(d, VisibilityMap::kCells) / 4;
      out |= std::uint64_t{1} << (kBlocks * at.y + at.x);
    }
  }
  return out;
}

// What is thin hides between the wide cells of one vertex, but not of all around it.
void VisibilityBake::refine(const std::function<void(double)>& progress) {
  const std::vector<std::uint32_t> place = places_of(mesh_.positions);
  const std::vector<std::vector<std::uint32_t>> around = neighbours(mesh_, place);
  std::vector<std::vector<std::uint64_t>> fine(place.size());
  parallel_for(std::size_t{0}, fine.size(), kAtOnce, [&](const auto& range) {
    for (std::size_t v = range.begin(); v < range.end(); ++v) {
      std::uint64_t& refined = visibility_.refined[v];
      refined = own_edges(v);
      for (const std::uint32_t other : around[place[v]]) refined |= edges_seen_by(other, v);
      const Eye eye(scene_, mesh_, v);
      for (std::uint64_t left = refined; left != 0; left &= left - 1)
        fine[v].push_back(eye.fine(std::countr_zero(left)));
    }
    progress(static_cast<double>(range.size()) / static_cast<double>(fine.size()));
  });
  std::size_t count = 0;
  for (const auto& of_vertex : fine) count += of_vertex.size();
  visibility_.fine.resize(count);
  auto to = visibility_.fine.begin();
  for (const auto& of_vertex : fine) to = std::ranges::copy(of_vertex, to).out;
}

}  // namespace penumbra::prt
