// What each vertex of a mesh sees past the mesh itself, kept from its bake: a look-up where a ray
// would be asked.
#pragma once

#include <cmath>
#include <cstdint>
#include <glm/ext/vector_int2.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <numbers>
#include <span>
#include <vector>

#include "prt/geometry/mesh.h"
#include "prt/transfer/cow_vector.h"
#include "prt/transfer/vertex_samples.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// By vertex a bit for each cell of a square that maps to its hemisphere: whether a ray there meets
/// nothing of the mesh. Where it sees an edge there are bits of cells half as wide.
struct VisibilityMap {
  static constexpr int kCells = 32, kFineCells = 64;  // along a side of the square
  static constexpr int kBlocks = 8;                   // of cells, along a side
  static constexpr std::size_t kWords = 32;           // a vertex
  /// kWords a vertex, two blocks of four by four cells in each.
  CowVector<std::uint32_t> open;
  /// By vertex, bit by block: whether it has finer cells. All cells of others are alike.
  CowVector<std::uint64_t> refined;
  /// Eight by eight finer cells of a refined block in each: those of the first vertex, then of the
  /// next one.
  CowVector<std::uint64_t> fine;

  VisibilityMap() = default;
  explicit VisibilityMap(std::size_t vertices) : open(kWords * vertices), refined(vertices) {}
  bool empty() const { return refined.empty(); }
  std::uint32_t block(std::size_t vertex, int at) const {
    return open[kWords * vertex + static_cast<std::size_t>(at / 2)] >> 16 * (at % 2) & 0xffffu;
  }
  /// RMS angle that a look-up is off, radians.
  static double blur(int cells) { return std::sqrt(std::numbers::pi / 3) / cells; }
};

/// Where a vertex's square lies. From one to the next it is turned, and rays go through other
/// places of their cells.
/// source: hemi-octahedral map, Cigolle, Donow, Evangelakos, Mara, McGuire & Meyer 2014
struct HemiOctFrame {
  glm::vec3 first, second, normal;

  glm::vec2 fine_shift;  // .25 or .75 each
  /// Of a ray in its cell, 0..1: a coarse cell's ray is that of the last of its four finer cells.
  glm::vec2 shift(int cells) const {
    return cells == VisibilityMap::kCells ? .5f * (1.f + fine_shift) : fine_shift;
  }
  static HemiOctFrame of(std::size_t vertex, const glm::vec3& normal);
  /// Of the ray in cell (x, y).
  glm::vec3 direction(int x, int y, int cells) const;
  /// The cell whose ray is about the nearest to a direction of the hemisphere.
  glm::ivec2 cell(const glm::vec3& direction, int cells) const;
};

/// What a look-up asks first of a vertex, in one line of the cache.
struct alignas(64) VisibilityHead {
  HemiOctFrame frame;
  std::uint32_t first_fine;  // of its refined blocks
  std::uint64_t refined;
};

/// Of a vertex, over some directions, the sums of the cosine.
struct CosineSums {
  float seen = 0;  // of what counts and is seen
  float open = 0;  // of all
  friend CosineSums operator+(CosineSums a, CosineSums b) {
    return {a.seen + b.seen, a.open + b.open};
  }
  friend CosineSums operator-(CosineSums a, CosineSums b) {
    return {a.seen - b.seen, a.open - b.open};
  }
};

/// Directions to look into, other ones for each of `turns` vertices that follow each other.
class VisibilitySamples {
 public:
  static constexpr std::size_t kMax = 16, kFew = 8;  // at once; a vertex looks into so many or more

  /// threads: thread-bound; memory grows once
  /// in: cells kCells, or kFineCells: half as blurred, and slower; each a multiple of kMax, or in
  /// finer cells of kFew
  void clear(int cells, std::size_t each = kMax) {
    cells_ = cells, each_ = each;
    x_.clear(), y_.clear(), z_.clear(), counts_.clear();
  }
  /// Of one vertex `each` after each other. `counts`: whether its light counts where it is seen.
  /// in: unit, bake frame
  void add(const glm::vec3& direction, bool counts) {
    x_.push_back(direction.x), y_.push_back(direction.y), z_.push_back(direction.z);
    counts_.push_back(counts ? 1.f : 0.f);
  }
  int cells() const { return cells_; }
  std::size_t each() const { return each_; }
  std::size_t turns() const { return x_.size() / each_; }
  std::span<const float> x() const { return x_; }
  std::span<const float> y() const { return y_; }
  std::span<const float> z() const { return z_; }
  std::span<const float> counts() const { return counts_; }

 private:
  int cells_ = VisibilityMap::kCells;
  std::size_t each_ = kMax;
  std::vector<float> x_, y_, z_, counts_;
};

/// threads: const members reentrant
class VisibilityLookup {
 public:
  /// The visibility must outlive it, unchanged.
  /// in: a visibility map that is not empty, with all of its finer cells, and the mesh that was
  /// baked
  VisibilityLookup(const VisibilityMap& visibility, const Mesh& mesh);

  const VertexSamples& samples() const { return samples_; }
  /// Of vertices [first, last), each over its own directions.
  void look_up(const VisibilitySamples& directions_used, std::size_t first, std::size_t last,
               std::span<CosineSums> out) const {
    look_up(directions_used, {}, first, last, out);
  }
  /// The same of places [first, last) of a list of vertices; directions and `out` are by place.
  void look_up(const VisibilitySamples& directions_used, std::span<const std::uint32_t> vertices,
               std::size_t first, std::size_t last, std::span<CosineSums> out) const;

 private:
  const VisibilityMap* visibility_;
  VertexSamples samples_;
  std::vector<VisibilityHead> heads_;  // by vertex
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
