#include "shadows/outline_sides.h"

#include <algorithm>
#include <array>
#include <cassert>

#include "shadows/projection_kernel.h"

namespace penumbra::shadows {

namespace {

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
      : outline_(*caster.outline),
        grid_(grid),
        all_(bits_of(taps.size())),
        places_(memory),
        above_(memory),
        facing_(memory) {
    for (const PlaneTap& t : taps) {
      const glm::vec2 shift = glm::vec2(t.shift) / grid.cell_m;
      reach_low_ = glm::min(reach_low_, shift);
      reach_high_ = glm::max(reach_high_, shift);
    }
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
    if (!all_above_) add_cuts(out);
  }

 private:
  void place(const Caster& caster, const NodeGrid& grid, float near_m) {
    const Pose map_from_mesh = grid.world_from_map.inverse() * caster.world_from_mesh;
    const glm::mat3 turn(map_from_mesh.rotation_matrix());
    const glm::vec3 shift = glm::vec3(map_from_mesh.translation) - glm::vec3(0, near_m, 0),
                    scale(1 / grid.cell_m, 1, 1 / grid.cell_m);
    places_.reserve(caster.mesh->positions.size());
    above_.reserve(caster.mesh->positions.size());
    for (const glm::vec3& p : caster.mesh->positions) {
      places_.push_back(scale * (turn * p + shift));
      above_.push_back(places_.back().y >= 0);
      all_above_ &= above_.back() != 0;
    }
  }

  // Where an edge goes through the plane; the same from both ends.
  glm::vec3 cut(std::uint32_t i, std::uint32_t j) const {
    const glm::vec3 &a = places_[std::min(i, j)], &b = places_[std::max(i, j)];
    const float t = a.y / (a.y - b.y);
    return {a.x + t * (b.x - a.x), 0, a.z + t * (b.z - a.z)};
  }
  bool above(std::uint32_t i) const { return above_[i] != 0; }

  void add(std::uint32_t from, std::uint32_t to, std::uint64_t more, std::uint64_t fewer,
           std::int16_t layers, std::pmr::vector<Side>& out) const {
    if (!above(from) && !above(to)) return;
    add({above(from) ? places_[from] : cut(from, to), above(to) ? places_[to] : cut(from, to), more,
         fewer, layers},
        out);
  }
  void add(const Side& side, std::pmr::vector<Side>& out) const {
    const auto lowest = [&](float a, float b, float reach) {
      return std::min(a + side.from.y * reach, b + side.to.y * reach);
    };
    const float right = lowest(side.from.x, side.to.x, reach_low_.x),
                bottom = lowest(side.from.z, side.to.z, reach_low_.y),
                top = -lowest(-side.from.z, -side.to.z, -reach_high_.y);
    if (grid_.depth > 0 && (right > grid_.width || bottom > grid_.depth || top < -1)) return;
    out.push_back(side);
  }

  // Of triangles that go through the plane only what is above counts: it ends along the cut.
  void add_cuts(std::pmr::vector<Side>& out) const {
    const std::span<const Outline::Triangle> triangles = outline_.triangles();
    for (std::size_t t = 0; t < triangles.size(); ++t) {
      const int corners = above(triangles[t][0]) + above(triangles[t][1]) + above(triangles[t][2]);
      if (corners == 0 || corners == 3) continue;
      glm::vec3 down(0), up(0);
      for (std::size_t k = 0; k < 3; ++k) {
        const std::uint32_t a = triangles[t][k], b = triangles[t][(k + 1) % 3];
        if (above(a) == above(b)) continue;
        (above(a) ? down : up) = cut(a, b);
      }
      add({down, up, facing_[t], all_ & ~facing_[t], 1}, out);
    }
  }

  const Outline& outline_;
  const NodeGrid& grid_;
  std::uint64_t all_;
  glm::vec2 reach_low_{1e30f}, reach_high_{-1e30f};  // of shadows, cells for each metre of height
  bool all_above_ = true;
  std::pmr::vector<glm::vec3> places_;
  std::pmr::vector<char> above_;
  std::pmr::vector<std::uint64_t> facing_;
};

}  // namespace

std::pmr::vector<Side> find_sides(std::span<const Caster> casters, const NodeGrid& grid,
                                  float near_m, std::span<const PlaneTap> taps,
                                  std::pmr::memory_resource* memory) {
  assert(taps.size() <= kMostDirections);
  std::pmr::vector<Side> out(memory);
  for (const Caster& c : casters) OutlineFinder(c, grid, near_m, taps, memory).add_sides(out);
  return out;
}

}  // namespace penumbra::shadows
