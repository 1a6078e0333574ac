#include <algorithm>
#include <bit>
#include <glm/ext/vector_int2.hpp>
#include <glm/geometric.hpp>
#include <optional>
#include <span>
#include <utility>

#include "prt/bake/bake_rules.h"
#include "prt/bake/internal/visibility_bake.h"

namespace penumbra::prt {

namespace {

constexpr int kFineCells = VisibilityMap::kFineCells, kBlocks = VisibilityMap::kBlocks;
constexpr int kWide = VisibilityBake::kWideCells;
constexpr int kFineInWide = kFineCells / kWide;  // along a side
constexpr std::uint64_t kAllOpen = ~std::uint64_t{0};

static_assert(RayScene::kPacket == 16 && kFineInWide == 4 && kWide == 2 * kBlocks);

// The finer cell, of four by four, through which a wide cell's ray goes: one in the middle.
constexpr int kWideRay = 2;

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

void VisibilityBake::wide_rays(const HemiOctFrame& frame, int block, RayScene::RayPacket& packet) {
  for (int i = 0; i < RayScene::kPacket; ++i) {
    const glm::ivec2 cell(4 * (block % 4) + i % 4, 4 * (block / 4) + i / 4);
    const glm::ivec2 ray = kFineInWide * cell + kWideRay;
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

// Cells in whose directions a vertex around sees an edge, up to two away along the mesh.
VisibilityBake::Rows VisibilityBake::edges_of_others(std::size_t vertex) const {
  const std::vector<std::uint32_t>& beside = around_[place_[vertex]];
  std::vector<std::uint32_t> others = beside;
  for (const std::uint32_t other : beside)
    others.insert(others.end(), around_[place_[other]].begin(), around_[place_[other]].end());
  std::ranges::sort(others);
  others.erase(std::ranges::unique(others).begin(), others.end());
  Rows out{};
  const HemiOctFrame to = HemiOctFrame::of(vertex, mesh_.normals[vertex]);
  for (const std::uint32_t other : others) {
    const HemiOctFrame from = HemiOctFrame::of(other, mesh_.normals[other]);
    const Rows edges = beside_edges(wide_[other]);
    for (std::size_t y = 0; y < edges.size(); ++y)
      for (unsigned left = edges[y]; left != 0; left &= left - 1) {
        const glm::ivec2 cell(std::countr_zero(left), static_cast<int>(y));
        const glm::ivec2 ray = kFineInWide * cell + kWideRay;
        const glm::vec3 d = from.direction(ray.x, ray.y, kFineCells);
        if (!(glm::dot(d, to.normal) > 0)) continue;
        const glm::ivec2 at = to.cell(d, kFineCells) / kFineInWide;
        out[static_cast<std::size_t>(at.y)] |= static_cast<std::uint16_t>(1u << at.x);
      }
  }
  return out;
}

// Cells to trace, each once.
class CellQueue {
 public:
  void ask(int x, int y) {
    std::uint16_t& row = asked_[static_cast<std::size_t>(y)];
    if (row >> x & 1) return;
    row |= static_cast<std::uint16_t>(1u << x);
    waiting_[count_++] = {x, y};
  }
  void ask_all(const VisibilityBake::Rows& rows) {
    for (int y = 0; y < kWide; ++y)
      for (unsigned left = rows[static_cast<std::size_t>(y)]; left != 0; left &= left - 1)
        ask(std::countr_zero(left), y);
  }
  bool was_asked(int x, int y) const { return asked_[static_cast<std::size_t>(y)] >> x & 1; }
  std::optional<glm::ivec2> next() {
    if (done_ == count_) return std::nullopt;
    return waiting_[done_++];
  }

 private:
  VisibilityBake::Rows asked_{};
  std::array<glm::ivec2, kWide * kWide> waiting_;
  std::size_t count_ = 0, done_ = 0;
};

// An edge that leaves a cell goes on in the next one: cells of which the finer ones of this one do
// not look as they do where they touch.
static void follow_edges(glm::ivec2 cell, std::uint32_t open, const VisibilityBake::Rows& wide,
                         CellQueue& queue) {
  struct NextCell {
    int x, y;
    std::uint32_t touching;  // of the finer cells
  };
  constexpr NextCell kNext[] = {{-1, 0, 0x1111}, {1, 0, 0x8888}, {0, -1, 0x000f}, {0, 1, 0xf000}};
  for (const NextCell& next : kNext) {
    const int x = cell.x + next.x, y = cell.y + next.y;
    if (x < 0 || x >= kWide || y < 0 || y >= kWide) continue;
    const bool is_open = (wide[static_cast<std::size_t>(y)] >> x & 1) != 0;
    if ((open & next.touching) != (is_open ? next.touching : 0)) queue.ask(x, y);
  }
}

OpenCells VisibilityBake::refine(std::size_t vertex) {
  const Rows& wide = wide_[vertex];
  const HemiOctFrame frame = HemiOctFrame::of(vertex, mesh_.normals[vertex]);
  const glm::vec3 origin = mesh_.positions[vertex] + kRayNear * mesh_.normals[vertex];
  OpenCells out{};
  const auto put = [&](int x, int y, std::uint64_t open) {  // rows of four bits
    std::uint64_t& block = out[static_cast<std::size_t>(kBlocks * (y / 2) + x / 2)];
    for (int shift = 32 * (y % 2) + 4 * (x % 2); open != 0; open >>= 4, shift += 8)
      block |= (open & 15) << shift;
  };
  CellQueue queue;
  queue.ask_all(beside_edges(wide));
  queue.ask_all(edges_of_others(vertex));
  std::uint64_t rays = RayScene::kPacket * kPackets;
  while (const auto cell = queue.next()) {
    RayScene::RayPacket packet;
    for (int i = 0; i < RayScene::kPacket; ++i) {
      const glm::vec3 d = frame.direction(4 * cell->x + i % 4, 4 * cell->y + i / 4, kFineCells);
      packet.x[i] = d.x, packet.y[i] = d.y, packet.z[i] = d.z;
    }
    const std::uint32_t open = ~scene_.occluded(origin, kRayNear, packet) & 0xffffu;
    put(cell->x, cell->y, open);
    follow_edges(*cell, open, wide, queue);
    rays += RayScene::kPacket;
  }
  for (int y = 0; y < kWide; ++y)
    for (int x = 0; x < kWide; ++x)
      if (!queue.was_asked(x, y) && (wide[static_cast<std::size_t>(y)] >> x & 1) != 0)
        put(x, y, 0xffffu);
  rays_ += rays;
  keep(vertex, out);
  return out;
}

// A coarse cell is as the last of its four finer ones.
void VisibilityBake::keep(std::size_t vertex, const OpenCells& open) {
  for (std::size_t block = 0; block < open.size(); ++block) {
    const std::uint64_t bits = open[block] >> (8 + 1);  // in the second row and column
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
