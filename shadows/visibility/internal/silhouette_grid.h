// Silhouettes over a grid as the light sees it: which of them are over a place.
#pragma once

#include <cstdint>
#include <memory_resource>
#include <span>
#include <vector>

#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/place_kernel.h"
#include "shadows/silhouette/silhouette_cache.h"
#include "shadows/silhouette/silhouette_mesh.h"

namespace penumbra::shadows {

/// x and z in cells, y in metres towards the light.
struct LightGrid {
  Pose grid_from_world;  // metres
  float cell_m;
  int width, depth;  // cells

  AffineTransform from(const Pose& world_from_mesh) const;
};

/// Of an edge that is a silhouette, as much as lies over some cells.
struct SilhouetteLine {
  glm::vec3 from, to;
  std::uint32_t caster_frame, edge;
};
/// What has silhouettes, as the grid has them.
struct CasterFrame {
  const SilhouetteMesh* silhouette;
  glm::mat3 turn_normals;  // from the mesh's frame, not to unit length
};
struct SilhouetteLines {
  std::pmr::vector<SilhouetteLine> lines;
  std::pmr::vector<CasterFrame> caster_frames;
};
/// The silhouettes of casters where they are higher than the grid's foot. `places` are the vertices
/// of `object` in the grid.
SilhouetteLines lines_of(const ShadowCasters& casters, const Caster& object,
                         std::span<const glm::vec3> places, const LightGrid& grid,
                         const DirectionCone& cone, SilhouetteCache& cache,
                         std::pmr::memory_resource* memory);

/// threads: const members reentrant
class SilhouetteGrid {
 public:
  /// `drop`: metres below a silhouette at which the light casts its shadow aside by a cell. Keeps
  /// the lines.
  SilhouetteGrid(std::span<const SilhouetteLine> lines, const LightGrid& grid, float drop,
                 std::pmr::memory_resource* memory);

  /// Whether nothing hides a part of the light only at the places, and nothing passes between them:
  /// a first look. in, here and below: places within the grid
  bool are_clear_of(const glm::vec3& a, const glm::vec3& b) const {
    return !any_cell(a, b, [](std::size_t) { return true; });
  }
  /// Whether a silhouette hides a part of the light only. False where pass_between() tells it of
  /// every way from there.
  bool in_penumbra(const glm::vec3& p) const;
  bool pass_between(const glm::vec3& a, const glm::vec3& b) const;

  /// Whether the lines over each cell are known: where no shadow is cast aside by a cell.
  bool has_lists() const { return !last_.empty(); }
  /// Calls f(line) for all that can hide a part of the light from the place.
  /// in: has_lists()
  template <class F>
  void each_over(const glm::vec3& p, F f) const {
    const std::size_t cell = index(static_cast<int>(p.x), static_cast<int>(p.z));
    for (const Where where : {kOver, kBeside})
      any_line(cell, where, p.y, [&](const SilhouetteLine& line) {
        if (may_reach(line, p)) f(line);
        return false;
      });
  }

 private:
  struct Listed {
    std::uint32_t line, before;
    float height;
  };
  enum Where : std::size_t { kOver, kBeside };
  static constexpr std::uint32_t kNone = 0xffffffffu;
  static constexpr float kRounding = .02f;  // cells

  // False where even the highest of the line casts its shadow too little aside: a first look.
  bool may_reach(const SilhouetteLine& line, const glm::vec3& p) const {
    const float reach = (std::max(line.from.y, line.to.y) - p.y) * per_drop_ + kRounding;
    const auto near = [&](float from, float to, float at) {
      return std::min(from, to) - reach < at && at < std::max(from, to) + reach;
    };
    return near(line.from.x, line.to.x, p.x) && near(line.from.z, line.to.z, p.z);
  }

  template <class F>
  void each_cell(const SilhouetteLine& line, F f) const;
  void list(std::uint32_t line, Where where, std::size_t cell, float height);
  void spread();
  void lift(int x, int z, int way);
  // Whether f(cell) is true for a cell between the places over which a silhouette passes.
  template <class F>
  bool any_cell(const glm::vec3& a, const glm::vec3& b, F f) const {
    const glm::vec3 low = glm::min(a, b), high = glm::max(a, b);
    for (int z = static_cast<int>(low.z); z <= static_cast<int>(high.z); ++z)
      for (int x = static_cast<int>(low.x); x <= static_cast<int>(high.x); ++x)
        if (height_[index(x, z)] >= low.y && f(index(x, z))) return true;
    return false;
  }
  // Of those listed in a cell that are higher than `low`.
  template <class F>
  bool any_line(std::size_t cell, Where where, float low, F f) const {
    for (std::uint32_t i = last_[2 * cell + where]; i != kNone; i = listed_[i].before)
      if (listed_[i].height >= low && f(lines_[listed_[i].line])) return true;
    return false;
  }
  std::size_t index(int x, int z) const { return static_cast<std::size_t>(z * width_ + x); }

  std::span<const SilhouetteLine> lines_;
  int width_, depth_;
  float drop_, per_drop_;
  std::pmr::vector<float> height_;
  // The lines over each cell, from its last one back; empty without lists.
  std::pmr::vector<std::uint32_t> last_;
  std::pmr::vector<Listed> listed_;
};

}  // namespace penumbra::shadows
