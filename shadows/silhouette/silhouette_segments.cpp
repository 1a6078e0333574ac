#include "shadows/silhouette/internal/silhouette_segments.h"

#include <hwy/cache_control.h>

#include <algorithm>
#include <cassert>
#include <cmath>

#include "shadows/silhouette/projection_kernel.h"
#include "shadows/silhouette/silhouette_mesh.h"

namespace penumbra::shadows {

namespace {

Directions directions_to(std::span<const PlaneSample> samples, const glm::dmat3& mesh_from_plane) {
  Directions out{};
  out.count = samples.size();
  for (std::size_t k = 0; k < samples.size(); ++k) {
    const glm::dvec3 d = mesh_from_plane * glm::dvec3(-samples[k].shift.x, 1, -samples[k].shift.y);
    out.x[k] = static_cast<float>(d.x), out.y[k] = static_cast<float>(d.y),
    out.z[k] = static_cast<float>(d.z);
  }
  return out;
}

// The silhouettes of one mesh against all directions.
class SilhouetteFinder {
 public:
  SilhouetteFinder(const Caster& caster, const NodeGrid& grid, float near_m,
                   std::span<const PlaneSample> samples)
      : silhouette_(*caster.silhouette),
        positions_(caster.mesh->positions),
        grid_(grid),
        all_(bits_of(samples.size())),
        directions_(
            directions_to(samples, glm::transpose(caster.world_from_mesh.rotation_matrix()) *
                                       grid.world_from_map.rotation_matrix())) {
    for (const PlaneSample& t : samples) {
      const glm::vec2 shift = glm::vec2(t.shift) / grid.cell_m;
      reach_low_ = glm::min(reach_low_, shift);
      reach_high_ = glm::max(reach_high_, shift);
    }
    const Pose map_from_mesh = grid.world_from_map.inverse() * caster.world_from_mesh;
    turn_ = glm::mat3(map_from_mesh.rotation_matrix());
    shift_ = glm::vec3(map_from_mesh.translation) - glm::vec3(0, near_m, 0);
    scale_ = {1 / grid.cell_m, 1, 1 / grid.cell_m};
  }

  /// in: all edges that are a silhouette for one of the samples
  void add_silhouettes(std::span<const std::uint32_t> edges,
                       std::pmr::vector<SilhouetteSegment>& out) const {
    for (std::size_t i = 0; i < edges.size(); ++i) {
      prefetch_after(edges.subspan(i));
      const SilhouetteMesh::Edge& e = silhouette_.edges()[edges[i]];
      const std::uint64_t left = facing(e.left);
      if (e.right == SilhouetteMesh::kOpen)
        add(e, left, all_ & ~left, 1, out);
      else if (const std::uint64_t right = facing(e.right); left != right)
        add(e, left & ~right, right & ~left, 2, out);
    }
  }
  // Of triangles that go through the plane only what is above counts: it ends along the cut.
  void add_cuts(std::pmr::vector<SilhouetteSegment>& out) const {
    for (std::size_t p = 0; p < silhouette_.patches().size(); ++p) {
      if (!goes_through(silhouette_.patches()[p])) continue;
      for (const SilhouetteMesh::Edge& e : silhouette_.edges_of(p)) {
        if (!cuts(e.from, e.to)) continue;
        add_cut(e, e.left, out);
        if (e.right != SilhouetteMesh::kOpen) add_cut(e, e.right, out);
      }
    }
  }

 private:
  // Memory is what a list of edges waits for: asked for ahead, then the normals beside them.
  void prefetch_after(std::span<const std::uint32_t> edges) const {
    constexpr std::size_t kEdge = 16, kNormals = 8;
    if (kEdge < edges.size()) hwy::Prefetch(&silhouette_.edges()[edges[kEdge]]);
    if (kNormals >= edges.size()) return;
    const SilhouetteMesh::Normals& n = silhouette_.normals();
    const SilhouetteMesh::Edge& e = silhouette_.edges()[edges[kNormals]];
    for (const std::uint32_t t : {e.left, e.right == SilhouetteMesh::kOpen ? e.left : e.right})
      hwy::Prefetch(&n.x[t]), hwy::Prefetch(&n.y[t]), hwy::Prefetch(&n.z[t]);
  }
  glm::vec3 place(const glm::vec3& p) const { return scale_ * (turn_ * p + shift_); }
  static bool above(const glm::vec3& place) { return place.y >= 0; }
  bool goes_through(const SilhouetteMesh::Patch& patch) const {
    constexpr float kRounding = 1 + 1e-5f;
    return std::abs(place(patch.centre).y) <= kRounding * patch.radius_m;
  }
  // Bit k: faces direction k.
  std::uint64_t facing(std::uint32_t triangle) const {
    const SilhouetteMesh::Normals& n = silhouette_.normals();
    return find_facing(n.x[triangle], n.y[triangle], n.z[triangle], directions_);
  }

  // Where an edge goes through the plane; the same from both ends.
  glm::vec3 cut(std::uint32_t i, std::uint32_t j) const {
    const glm::vec3 a = place(positions_[std::min(i, j)]), b = place(positions_[std::max(i, j)]);
    const float t = a.y / (a.y - b.y);
    return {a.x + t * (b.x - a.x), 0, a.z + t * (b.z - a.z)};
  }

  void add(const SilhouetteMesh::Edge& e, std::uint64_t more, std::uint64_t fewer,
           std::int16_t layers, std::pmr::vector<SilhouetteSegment>& out) const {
    const glm::vec3 from = place(positions_[e.from]), to = place(positions_[e.to]);
    if (!above(from) && !above(to)) return;
    add({above(from) ? from : cut(e.from, e.to), above(to) ? to : cut(e.from, e.to), more, fewer,
         layers},
        out);
  }
  void add(const SilhouetteSegment& side, std::pmr::vector<SilhouetteSegment>& out) const {
    const auto lowest = [&](float a, float b, float reach) {
      return std::min(a + side.from.y * reach, b + side.to.y * reach);
    };
    const float right = lowest(side.from.x, side.to.x, reach_low_.x),
                bottom = lowest(side.from.z, side.to.z, reach_low_.y),
                top = -lowest(-side.from.z, -side.to.z, -reach_high_.y);
    if (right > grid_.width || bottom > grid_.depth || top < -1) return;
    out.push_back(side);
  }

  bool cuts(std::uint32_t i, std::uint32_t j) const {
    return above(place(positions_[i])) != above(place(positions_[j]));
  }
  // A triangle has two such edges and counts at the one of the lower vertices.
  void add_cut(const SilhouetteMesh::Edge& e, std::uint32_t t,
               std::pmr::vector<SilhouetteSegment>& out) const {
    const SilhouetteMesh::Triangle& corners = silhouette_.triangles()[t];
    glm::vec3 down(0), up(0);
    for (std::size_t c = 0; c < 3; ++c) {
      const std::uint32_t a = corners[c], b = corners[(c + 1) % 3];
      if (!cuts(a, b)) continue;
      if (std::minmax(a, b) < std::minmax(e.from, e.to)) return;
      (above(place(positions_[a])) ? down : up) = cut(a, b);
    }
    assert(up != glm::vec3(0) || down != glm::vec3(0));
    const std::uint64_t faces = facing(t);
    add({down, up, faces, all_ & ~faces, 1}, out);
  }

  const SilhouetteMesh& silhouette_;
  std::span<const glm::vec3> positions_;
  const NodeGrid& grid_;
  std::uint64_t all_;
  Directions directions_;
  glm::vec2 reach_low_{1e30f}, reach_high_{-1e30f};  // of shadows, cells for each metre of height
  glm::mat3 turn_;
  glm::vec3 shift_, scale_;  // map from mesh
};

}  // namespace

std::pmr::vector<SilhouetteSegment> find_sides(std::span<const Caster> casters,
                                               const NodeGrid& grid, float near_m,
                                               const SampleCone& light, SilhouetteCache& cache,
                                               std::pmr::memory_resource* memory) {
  assert(light.samples.size() <= kMaxDirections);
  assert(std::ranges::all_of(light.samples, [&](const PlaneSample& t) {
    const glm::dvec3 d = grid.world_from_map.rotation * glm::dvec3(-t.shift.x, 1, -t.shift.y);
    return glm::length(glm::cross(glm::normalize(d), light.around.towards)) <
           light.around.sine + 1e-5;
  }));
  std::pmr::vector<SilhouetteSegment> out(memory);
  for (const Caster& c : casters) {
    const SilhouetteFinder finder(c, grid, near_m, light.samples);
    finder.add_silhouettes(cache.find(*c.silhouette, c.world_from_mesh, light.around), out);
    finder.add_cuts(out);
  }
  return out;
}

}  // namespace penumbra::shadows
