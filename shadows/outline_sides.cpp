#include "shadows/outline_sides.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "shadows/projection_kernel.h"

namespace penumbra::shadows {

namespace {

// The directions to the taps in a mesh's frame.
struct TapDirections {
  Directions all{};
  glm::vec3 middle{0};         // unit
  float sine = 1, cosine = 0;  // of the largest angle from the middle

  TapDirections(std::span<const PlaneTap> taps, const glm::dmat3& mesh_from_plane) {
    all.count = taps.size();
    glm::dvec3 mean(0);
    std::array<glm::dvec3, kMostDirections> to;
    for (std::size_t k = 0; k < taps.size(); ++k) {
      to[k] = mesh_from_plane * glm::dvec3(-taps[k].shift.x, 1, -taps[k].shift.y);
      mean += to[k] / static_cast<double>(taps.size());
      all.x[k] = static_cast<float>(to[k].x), all.y[k] = static_cast<float>(to[k].y),
      all.z[k] = static_cast<float>(to[k].z);
    }
    double spread = 0;
    for (std::size_t k = 0; k < taps.size(); ++k)
      spread = std::max(spread, glm::length(to[k] - mean));
    constexpr double kRounding = 1 + 1e-5;
    const double length = glm::length(mean);
    spread = kRounding * spread + 1e-6 * length;
    all.middle_x = static_cast<float>(mean.x), all.middle_y = static_cast<float>(mean.y),
    all.middle_z = static_cast<float>(mean.z);
    all.square_spread = static_cast<float>(spread * spread);
    if (!(spread < length)) return;
    middle = glm::vec3(mean / length);
    sine = static_cast<float>(spread / length);
    cosine = std::sqrt(1 - sine * sine);
  }
  /// Whether triangles with such normals face all directions, or none.
  bool see_alike(const Outline::Patch& cone) const {
    constexpr float kRounding = 1e-5f;
    return cone.cosine * cosine > cone.sine * sine &&
           std::abs(glm::dot(cone.axis, middle)) >
               cone.sine * cosine + cone.cosine * sine + kRounding;
  }
};

// The outlines of one mesh against all directions.
class OutlineFinder {
 public:
  OutlineFinder(const Caster& caster, const NodeGrid& grid, float near_m,
                std::span<const PlaneTap> taps)
      : outline_(*caster.outline),
        positions_(caster.mesh->positions),
        grid_(grid),
        all_(bits_of(taps.size())),
        directions_(taps, glm::transpose(caster.world_from_mesh.rotation_matrix()) *
                              grid.world_from_map.rotation_matrix()) {
    for (const PlaneTap& t : taps) {
      const glm::vec2 shift = glm::vec2(t.shift) / grid.cell_m;
      reach_low_ = glm::min(reach_low_, shift);
      reach_high_ = glm::max(reach_high_, shift);
    }
    const Pose map_from_mesh = grid.world_from_map.inverse() * caster.world_from_mesh;
    turn_ = glm::mat3(map_from_mesh.rotation_matrix());
    shift_ = glm::vec3(map_from_mesh.translation) - glm::vec3(0, near_m, 0);
    scale_ = {1 / grid.cell_m, 1, 1 / grid.cell_m};
  }

  void add_sides(std::pmr::vector<Side>& out) const {
    for (std::size_t p = 0; p < outline_.patches().size(); ++p) {
      const Outline::Patch& patch = outline_.patches()[p];
      if (!directions_.see_alike(patch)) add_outline(outline_.edges_of(p), out);
      if (goes_through(patch)) add_cuts(outline_.edges_of(p), out);
    }
  }

 private:
  glm::vec3 place(const glm::vec3& p) const { return scale_ * (turn_ * p + shift_); }
  static bool above(const glm::vec3& place) { return place.y >= 0; }
  bool goes_through(const Outline::Patch& patch) const {
    constexpr float kRounding = 1 + 1e-5f;
    return std::abs(place(patch.centre).y) <= kRounding * patch.radius_m;
  }

  // Bit k: faces direction k.
  using Facing = std::array<std::uint64_t, 2 * Outline::kTogether>;
  Facing facing(std::span<const std::uint32_t> triangles) const {
    const Outline::Normals& n = outline_.normals();
    std::array<float, 2 * Outline::kTogether> x, y, z;
    for (std::size_t i = 0; i < triangles.size(); ++i)
      x[i] = n.x[triangles[i]], y[i] = n.y[triangles[i]], z[i] = n.z[triangles[i]];
    Facing out;
    find_facing(x.data(), y.data(), z.data(), triangles.size(), directions_.all, out.data());
    return out;
  }
  void add_outline(std::span<const Outline::Edge> edges, std::pmr::vector<Side>& out) const {
    std::array<std::uint32_t, 2 * Outline::kTogether> triangles;
    std::size_t count = 0;
    for (const Outline::Edge& e : edges) {
      triangles[count++] = e.left;
      triangles[count++] = e.right == Outline::kOpen ? e.left : e.right;
    }
    const Facing faces = facing(std::span(triangles).first(count));
    for (std::size_t i = 0; i < edges.size(); ++i) {
      const std::uint64_t left = faces[2 * i], right = faces[2 * i + 1];
      if (edges[i].right == Outline::kOpen)
        add(edges[i], left, all_ & ~left, 1, out);
      else if (left != right)
        add(edges[i], left & ~right, right & ~left, 2, out);
    }
  }

  // Where an edge goes through the plane; the same from both ends.
  glm::vec3 cut(std::uint32_t i, std::uint32_t j) const {
    const glm::vec3 a = place(positions_[std::min(i, j)]), b = place(positions_[std::max(i, j)]);
    const float t = a.y / (a.y - b.y);
    return {a.x + t * (b.x - a.x), 0, a.z + t * (b.z - a.z)};
  }

  void add(const Outline::Edge& e, std::uint64_t more, std::uint64_t fewer, std::int16_t layers,
           std::pmr::vector<Side>& out) const {
    const glm::vec3 from = place(positions_[e.from]), to = place(positions_[e.to]);
    if (!above(from) && !above(to)) return;
    add({above(from) ? from : cut(e.from, e.to), above(to) ? to : cut(e.from, e.to), more, fewer,
         layers},
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

  bool cuts(std::uint32_t i, std::uint32_t j) const {
    return above(place(positions_[i])) != above(place(positions_[j]));
  }
  // Of triangles that go through the plane only what is above counts: it ends along the cut.
  void add_cuts(std::span<const Outline::Edge> edges, std::pmr::vector<Side>& out) const {
    for (const Outline::Edge& e : edges) {
      if (!cuts(e.from, e.to)) continue;
      add_cut(e, e.left, out);
      if (e.right != Outline::kOpen) add_cut(e, e.right, out);
    }
  }
  // A triangle has two such edges and counts at the one of the lower vertices.
  void add_cut(const Outline::Edge& e, std::uint32_t t, std::pmr::vector<Side>& out) const {
    const Outline::Triangle& corners = outline_.triangles()[t];
    glm::vec3 down(0), up(0);
    for (std::size_t c = 0; c < 3; ++c) {
      const std::uint32_t a = corners[c], b = corners[(c + 1) % 3];
      if (!cuts(a, b)) continue;
      if (std::minmax(a, b) < std::minmax(e.from, e.to)) return;
      (above(place(positions_[a])) ? down : up) = cut(a, b);
    }
    assert(up != glm::vec3(0) || down != glm::vec3(0));
    const std::uint64_t faces = facing({&t, 1})[0];
    add({down, up, faces, all_ & ~faces, 1}, out);
  }

  const Outline& outline_;
  std::span<const glm::vec3> positions_;
  const NodeGrid& grid_;
  std::uint64_t all_;
  TapDirections directions_;
  glm::vec2 reach_low_{1e30f}, reach_high_{-1e30f};  // of shadows, cells for each metre of height
  glm::mat3 turn_;
  glm::vec3 shift_, scale_;  // map from mesh
};

}  // namespace

std::pmr::vector<Side> find_sides(std::span<const Caster> casters, const NodeGrid& grid,
                                  float near_m, std::span<const PlaneTap> taps,
                                  std::pmr::memory_resource* memory) {
  assert(taps.size() <= kMostDirections);
  std::pmr::vector<Side> out(memory);
  for (const Caster& c : casters) OutlineFinder(c, grid, near_m, taps).add_sides(out);
  return out;
}

}  // namespace penumbra::shadows
