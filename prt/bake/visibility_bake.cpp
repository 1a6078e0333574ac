#include <algorithm>
#include <bit>
#include <glm/ext/vector_int2.hpp>
#include <glm/geometric.hpp>
#include <span>
#include <utility>

#include "prt/bake/bake_rules.h"
#include "prt/bake/internal/visibility_bake.h"
#include "prt/rays/ray_pattern.h"

namespace penumbra::prt {

namespace {

constexpr int kFineCells = VisibilityMap::kFineCells, kBlocks = VisibilityMap::kBlocks;
constexpr int kWide = VisibilityBake::kWideCells;
constexpr int kFineInWide = kFineCells / kWide;  // along a side
constexpr std::uint64_t kAllOpen = ~std::uint64_t{0};
// By wide cell of a block of two by two.
constexpr std::uint64_t kWideBits = 0x0f0f0f0f;

static_assert(RayScene::kPacket == 16 && kFineInWide == 4 && kWide == 2 * kBlocks);

// Of a wide cell the finer one through which its ray goes: one of the four in the middle, another one
// for other vertices.
glm::ivec2 wide_ray_in_cell(std::size_t vertex) {
  return 1 + HemiOctFrame::fine_of_four(vertex);
}

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
    : mesh_(mesh),
      scene_(scene),
      place_(places_of(mesh.positions)),
      around_(neighbours(mesh, place_)),
      wide_(mesh.positions.size()),
      fine_(mesh.positions.size()),
      visibility_(mesh.positions.size()) {}

void VisibilityBake::wide_rays(std::size_t vertex, int block, RayScene::RayPacket& packet) const {
  const HemiOctFrame frame = HemiOctFrame::of(vertex, mesh_.normals[vertex]);
  const glm::ivec2 in_cell = wide_ray_in_cell(vertex);
  for (int i = 0; i < RayScene::kPacket; ++i) {
    const glm::ivec2 cell(4 * (block % 4) + i % 4, 4 * (block / 4) + i / 4);
    const glm::ivec2 ray = kFineInWide * cell + in_cell;
    const glm::vec3 d = frame.direction(ray.x, ray.y, kFineCells);
    packet.x[i] = d.x, packet.y[i] = d.y, packet.z[i] = d.z;
  }
}

void VisibilityBake::keep_wide(std::size_t vertex, int block, std::uint32_t blocked) {
  std::uint32_t open = ~blocked & 0xffffu;
  for (int y = 4 * (block / 4); open != 0; ++y, open >>= 4)
    wide_[vertex][static_cast<std::size_t>(y)] |=
        static_cast<std::uint16_t>((open & 15) << 4 * (block % 4));
}

// Cells that do not look as one beside them.
static VisibilityBake::Rows beside_edges(const VisibilityBake::Rows& open) {
  VisibilityBake::Rows out{};
  for (std::size_t y = 0; y < open.size(); ++y) {
    const unsigned across = (open[y] ^ open[y] >> 1) & 0x7fffu;
    out[y] |= static_cast<std::uint16_t>(across | across << 1);
    if (y + 1 == open.size()) break;
    const auto along = static_cast<std::uint16_t>(open[y] ^ open[y + 1]);
    out[y] |= along, out[y + 1] |= along;
  }
  return out;
}

// Cells in whose directions a vertex around sees an edge, but for those beside an edge of its own:
// that is the same one.
VisibilityBake::Rows VisibilityBake::edges_of_others(std::size_t vertex, const Rows& own) const {
  Rows out{};
  const HemiOctFrame to = HemiOctFrame::of(vertex, mesh_.normals[vertex]);
  for (const std::uint32_t other : around_[place_[vertex]]) {
    const HemiOctFrame from = HemiOctFrame::of(other, mesh_.normals[other]);
    const Rows& seen = wide_[other];
    const glm::ivec2 in_cell = wide_ray_in_cell(other);
    for (std::size_t y = 0; y < seen.size(); ++y) {
      const std::uint16_t below = seen[std::min(y + 1, seen.size() - 1)];
      std::uint32_t edges = ((seen[y] ^ seen[y] >> 1) & 0x7fffu) | (seen[y] ^ below);
      for (; edges != 0; edges &= edges - 1) {
        const glm::ivec2 cell(std::countr_zero(edges), static_cast<int>(y));
        const glm::ivec2 ray = kFineInWide * cell + in_cell;
        const glm::vec3 d = from.direction(ray.x, ray.y, kFineCells);
        if (!(glm::dot(d, to.normal) > 0)) continue;
        const glm::ivec2 at = to.cell(d, kFineCells) / kFineInWide;
        out[static_cast<std::size_t>(at.y)] |= static_cast<std::uint16_t>(1u << at.x);
      }
    }
  }
  for (std::size_t y = 0; y < out.size(); ++y) {
    const unsigned before = own[y > 0 ? y - 1 : y], after = own[std::min(y + 1, own.size() - 1)];
    out[y] &= static_cast<std::uint16_t>(~(own[y] | own[y] << 1 | own[y] >> 1 | before | after));
  }
  return out;
}

OpenCells VisibilityBake::refine(std::size_t vertex) {
  const Rows& wide = wide_[vertex];
  const Rows own = beside_edges(wide), others = edges_of_others(vertex, own);
  const HemiOctFrame frame = HemiOctFrame::of(vertex, mesh_.normals[vertex]);
  const glm::vec3 origin = mesh_.positions[vertex] + kRayNear * mesh_.normals[vertex];
  OpenCells out{};
  std::uint64_t rays = RayScene::kPacket * kPackets;
  for (int y = 0; y < kWide; ++y)
    for (int x = 0; x < kWide; ++x) {
      std::uint64_t& block = out[static_cast<std::size_t>(kBlocks * (y / 2) + x / 2)];
      const int shift = 32 * (y % 2) + 4 * (x % 2);
      const auto row = static_cast<std::size_t>(y);
      if (((own[row] | others[row]) >> x & 1) == 0) {
        if (wide[row] >> x & 1) block |= kWideBits << shift;
        continue;
      }
      RayScene::RayPacket packet;
      for (int i = 0; i < RayScene::kPacket; ++i) {
        const glm::vec3 d = frame.direction(4 * x + i % 4, 4 * y + i / 4, kFineCells);
        packet.x[i] = d.x, packet.y[i] = d.y, packet.z[i] = d.z;
      }
      std::uint64_t open = ~scene_.occluded(origin, kRayNear, packet) & 0xffffu;
      for (int down = 0; down < 4; ++down, open >>= 4) block |= (open & 15) << (shift + 8 * down);
      rays += RayScene::kPacket;
    }
  rays_ += rays;
  keep(vertex, out);
  return out;
}

// Of four finer cells the coarse one is that in which its ray lies.
void VisibilityBake::keep(std::size_t vertex, const OpenCells& open) {
  const glm::ivec2 within = HemiOctFrame::fine_of_four(vertex);
  for (std::size_t block = 0; block < open.size(); ++block) {
    const std::uint64_t bits = open[block] >> (8 * within.y + within.x);
    std::uint32_t coarse = 0;
    for (int i = 0; i < 16; ++i)
      coarse |= static_cast<std::uint32_t>(bits >> (16 * (i / 4) + 2 * (i % 4)) & 1) << i;
    visibility_.open[vertex * VisibilityMap::kWords + block / 2] |= coarse << 16 * (block % 2);
    if (open[block] == 0 || open[block] == kAllOpen) continue;
    visibility_.refined[vertex] |= std::uint64_t{1} << block;
    fine_[vertex].push_back(open[block]);
  }
}

VisibilityMap VisibilityBake::take() {
  std::size_t count = 0;
  for (const auto& of_vertex : fine_) count += of_vertex.size();
  visibility_.fine.resize(count);
  auto to = visibility_.fine.begin();
  for (const auto& of_vertex : fine_) to = std::ranges::copy(of_vertex, to).out;
  return std::move(visibility_);
}

}  // namespace penumbra::prt
