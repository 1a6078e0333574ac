#include "shadows/projected_shadow.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "core/parallel.h"
#include "core/scratch.h"
#include "shadows/projection_kernel.h"

namespace penumbra::shadows {

namespace {

// A stretch of an outline: where it is passed upwards in z, so many layers more lie on its far side in x for the
// directions of `more`, and fewer for those of `fewer`.
struct Side {
  glm::vec3 from, to;  // x and z in cells, y in metres above the plane
  std::uint64_t more, fewer;
  std::int16_t layers;
};

std::uint64_t all_of(std::size_t count) {
  return count < 64 ? (std::uint64_t{1} << count) - 1 : ~std::uint64_t{0};
}

// The directions to the taps in a mesh's frame.
Directions directions_of(std::span<const PlaneTap> taps, const glm::dmat3& mesh_from_plane) {
  Directions out{};
  out.count = taps.size();
  glm::dvec3 middle(0);
  std::array<glm::dvec3, kMostDirections> all;
  for (std::size_t k = 0; k < taps.size(); ++k) {
    all[k] = mesh_from_plane * glm::dvec3(-taps[k].shift.x, 1, -taps[k].shift.y);
    middle += all[k] / static_cast<double>(taps.size());
    out.x[k] = static_cast<float>(all[k].x), out.y[k] = static_cast<float>(all[k].y),
    out.z[k] = static_cast<float>(all[k].z);
  }
  double spread = 0;
  for (std::size_t k = 0; k < taps.size(); ++k)
    spread = std::max(spread, glm::length(all[k] - middle));
  constexpr double kRounding = 1 + 1e-5;
  spread = kRounding * spread + 1e-6 * glm::length(middle);
  out.middle_x = static_cast<float>(middle.x), out.middle_y = static_cast<float>(middle.y),
  out.middle_z = static_cast<float>(middle.z);
  out.square_spread = static_cast<float>(spread * spread);
  return out;
}

// The outlines of one mesh against all directions.
class OutlineFinder {
 public:
  OutlineFinder(const Caster& caster, const NodeGrid& grid, float near_m,
                std::span<const PlaneTap> taps, std::pmr::memory_resource* memory)
      : outline_(*caster.outline), all_(all_of(taps.size())), places_(memory), facing_(memory) {
    place(caster, grid, near_m);
    const Outline::Normals& n = outline_.normals();
    facing_.resize(n.x.size());
    const glm::dmat3 mesh_from_plane(glm::transpose(caster.world_from_mesh.rotation_matrix()) *
                                     grid.world_from_map.rotation_matrix());
    find_facing(n.x.data(), n.y.data(), n.z.data(), n.x.size(),
                directions_of(taps, mesh_from_plane), facing_.data());
  }

  void add_sides(std::pmr::vector<Side>& out) const {
    for (const Outline::Edge& e : outline_.edges()) {
      const std::uint64_t left = facing_[e.left];
      if (e.right == Outline::kOpen) {
        add(e.from, e.to, left, all_ & ~left, 1, out);
      } else if (const std::uint64_t right = facing_[e.right]; left != right) {
        add(e.from, e.to, left & ~right, right & ~left, 2, out);
      }
    }
    if (lowest_ < 0) add_cuts(out);
  }

 private:
  void place(const Caster& caster, const NodeGrid& grid, float near_m) {
    const Pose map_from_mesh = grid.world_from_map.inverse() * caster.world_from_mesh;
    const glm::mat3 turn(map_from_mesh.rotation_matrix());
    const glm::vec3 shift = glm::vec3(map_from_mesh.translation) - glm::vec3(0, near_m, 0),
                    scale(1 / grid.cell_m, 1, 1 / grid.cell_m);
    places_.reserve(caster.mesh->positions.size());
    for (const glm::vec3& p : caster.mesh->positions) {
      places_.push_back(scale * (turn * p + shift));
      lowest_ = std::min(lowest_, places_.back().y);
    }
  }

  // Where an edge goes through the plane; the same from both ends.
  glm::vec3 cut(std::uint32_t i, std::uint32_t j) const {
    const glm::vec3 &a = places_[std::min(i, j)], &b = places_[std::max(i, j)];
    const float t = a.y / (a.y - b.y);
    return {a.x + t * (b.x - a.x), 0, a.z + t * (b.z - a.z)};
  }
  bool above(std::uint32_t i) const { return places_[i].y >= 0; }

  void add(std::uint32_t from, std::uint32_t to, std::uint64_t more, std::uint64_t fewer,
           std::int16_t layers, std::pmr::vector<Side>& out) const {
    if (!above(from) && !above(to)) return;
    out.push_back({above(from) ? places_[from] : cut(from, to),
                   above(to) ? places_[to] : cut(from, to), more, fewer, layers});
  }

  // Of triangles that go through the plane only what is above counts: it ends along the cut.
  void add_cuts(std::pmr::vector<Side>& out) const {
    const std::span<const Outline::Triangle> triangles = outline_.triangles();
    for (std::size_t t = 0; t < triangles.size(); ++t) {
      glm::vec3 down(0), up(0);
      bool is_cut = false;
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t a = triangles[t][k], b = triangles[t][(k + 1) % 3];
        if (above(a) == above(b)) continue;
        is_cut = true;
        (above(a) ? down : up) = cut(a, b);
      }
      if (is_cut) out.push_back({down, up, facing_[t], all_ & ~facing_[t], 1});
    }
  }

  const Outline& outline_;
  std::uint64_t all_;
  float lowest_ = 1e30f;
  std::pmr::vector<glm::vec3> places_;
  std::pmr::vector<std::uint64_t> facing_;
};

// First integer that is not less, of 0..limit.
int ceil_within(float x, float limit) {
  const float clamped = std::min(std::max(0.f, x), limit);
  const int whole = static_cast<int>(clamped);
  return whole + (static_cast<float>(whole) < clamped ? 1 : 0);
}

// Sixteen directions' layers over a grid: first as steps between neighbours in a row.
class Layers {
 public:
  Layers(int width, int height, std::pmr::memory_resource* memory)
      : width_(width), height_(height), steps_(static_cast<std::size_t>(width * height), memory) {}

  /// The directions of group `group` alone.
  void draw(std::span<const Side> sides, std::span<const PlaneTap> taps, std::size_t group,
            float cell_m) {
    const std::size_t first = kGroup * group;
    for (std::size_t k = first; k < std::min(first + kGroup, taps.size()); ++k)
      shift_[k - first] = glm::vec2(taps[k].shift / static_cast<double>(cell_m));
    for (const Side& s : sides) {
      draw(s, static_cast<std::uint16_t>(s.more >> first), s.layers);
      draw(s, static_cast<std::uint16_t>(s.fewer >> first), static_cast<std::int16_t>(-s.layers));
    }
  }
  /// Row y, once.
  void blocked(int y, std::span<std::uint16_t> out) {
    sum_steps(&steps_[index(0, y)], out.size(), out.data());
  }

 private:
  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y * width_ + x); }

  void draw(const Side& s, std::uint16_t directions, std::int16_t layers) {
    const auto right = static_cast<float>(width_), end = static_cast<float>(height_);
    for (unsigned left = directions; left != 0; left &= left - 1) {
      const auto k = static_cast<std::size_t>(std::countr_zero(left));
      float z0 = s.from.z + s.from.y * shift_[k].y, z1 = s.to.z + s.to.y * shift_[k].y;
      int row = ceil_within(z0, end), last = ceil_within(z1, end);
      if (row == last) continue;
      float x0 = s.from.x + s.from.y * shift_[k].x, x1 = s.to.x + s.to.y * shift_[k].x;
      std::int16_t step = layers;
      if (row > last) {
        std::swap(row, last), std::swap(x0, x1), std::swap(z0, z1);
        step = static_cast<std::int16_t>(-step);
      }
      const float slope = (x1 - x0) / (z1 - z0);
      for (; row < last; ++row) {
        const int x = ceil_within(x0 + (static_cast<float>(row) - z0) * slope, right);
        if (x == width_) continue;
        std::int16_t& at = steps_[index(x, row)].of[k];
        at = static_cast<std::int16_t>(at + step);
      }
    }
  }

  int width_, height_;
  std::pmr::vector<Counts> steps_;
  std::array<glm::vec2, kGroup> shift_{};  // cells a metre
};

// The sum of weights for each set of sixteen directions.
class WeightSums {
 public:
  WeightSums(std::span<const PlaneTap> taps, std::size_t group) {
    for (std::size_t half = 0; half < 2; ++half)
      for (std::size_t bits = 1; bits < 256; ++bits) {
        const std::size_t tap =
            kGroup * group + 8 * half + static_cast<std::size_t>(std::countr_zero(bits));
        sums_[half][bits] =
            sums_[half][bits & (bits - 1)] + (tap < taps.size() ? taps[tap].weight : 0);
      }
  }
  float operator()(unsigned directions) const {
    return sums_[0][directions & 255] + sums_[1][directions >> 8];
  }

 private:
  std::array<std::array<float, 256>, 2> sums_{};
};

std::pmr::vector<Side> sides_of(std::span<const Caster> casters, const NodeGrid& grid, float near_m,
                                std::span<const PlaneTap> taps, std::pmr::memory_resource* memory) {
  std::pmr::vector<Side> out(memory);
  for (const Caster& c : casters) OutlineFinder(c, grid, near_m, taps, memory).add_sides(out);
  return out;
}

}  // namespace

void add_projected_shadows(const Casters& casters, const NodeGrid& grid,
                           std::span<const PlaneTap> taps, Image<float>& taken,
                           Image<float>& missing) {
  assert(taps.size() <= kMostDirections);
  const int width = taken.width(), height = taken.height();
  const Scratch::Scope scope;
  const std::pmr::vector<Side> of_virtual = sides_of(casters.virtual_things, grid, casters.near_m,
                                                     taps, scope.memory()),
                               of_real = sides_of(casters.real_things, grid, casters.near_m, taps,
                                                  scope.memory());
  Layers virtual_layers(width, height, scope.memory()),
      real_layers(width, of_real.empty() ? 0 : height, scope.memory());
  std::pmr::vector<std::uint16_t> blocked(static_cast<std::size_t>(width), scope.memory()),
      by_real(static_cast<std::size_t>(width), scope.memory());
  for (std::size_t group = 0; kGroup * group < taps.size(); ++group) {
    const WeightSums weight(taps, group);
    virtual_layers.draw(of_virtual, taps, group, grid.cell_m);
    if (!of_real.empty()) real_layers.draw(of_real, taps, group, grid.cell_m);
    for (int y = 0; y < height; ++y) {
      virtual_layers.blocked(y, blocked);
      if (!of_real.empty()) real_layers.blocked(y, by_real);
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(x);
        if ((blocked[i] | by_real[i]) == 0) continue;
        taken.at(x, y) += weight(blocked[i] & ~unsigned{by_real[i]});
        if (!missing.empty()) missing.at(x, y) += weight(by_real[i]);
      }
    }
  }
}

}  // namespace penumbra::shadows
