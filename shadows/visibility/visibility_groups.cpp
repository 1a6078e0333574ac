#include "shadows/visibility/internal/visibility_groups.h"

#include <algorithm>
#include <cmath>
#include <glm/gtx/quaternion.hpp>
#include <optional>

#include "core/threads/parallel.h"
#include "core/threads/scratch.h"
#include "prt/geometry/mesh.h"
#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/place_kernel.h"
#include "shadows/silhouette/projection_kernel.h"
#include "shadows/silhouette/silhouette_cache.h"
#include "shadows/visibility/internal/silhouette_grid.h"
#include "shadows/visibility/internal/soft_shadow_volume.h"

namespace penumbra::shadows {

namespace {

constexpr float kMaxCells = 192;  // across an object seen from the light
// Radians: of a wider light most vertices see a part, and looking for the others costs more than
// their rays.
constexpr double kWidest = .15;
constexpr float kCosineRounding = 1e-5f;

struct LightBox {
  glm::vec3 low, high;
};
LightBox turned(const prt::Bounds& bounds, const glm::mat3& turn) {
  const glm::vec3 centre = turn * bounds.centre(), half = .5f * (bounds.high - bounds.low);
  glm::vec3 reach(0);
  for (int k = 0; k < 3; ++k) reach += glm::abs(turn[k]) * half[k];
  return {centre - reach, centre + reach};
}

// Whether another caster reaches into the sphere around the object.
bool others_reach(std::span<const Caster> casters, const Caster& object) {
  const BoundingSphere here = sphere_of(object);
  return std::ranges::any_of(casters, [&](const Caster& c) {
    const BoundingSphere other = sphere_of(c);
    return !is_same(c, object) &&
           glm::distance(other.centre, here.centre) < here.radius + other.radius;
  });
}

// The vertices of an object in front of the light, and what is above them.
class VertexView {
 public:
  VertexView(std::span<const glm::vec3> places, std::span<std::uint8_t> sides,
             const SilhouetteGrid& silhouettes)
      : silhouettes_(silhouettes), places_(places), sees_(sides) {}
  /// False of vertices whose middle of the light is behind them, or known to lie in a penumbra.
  bool may_join(std::size_t i) const { return sees_[i] == kUnknown || sees_[i] == kOpen; }
  /// in: vertices that may share
  bool see_alike(std::size_t a, std::size_t b) {
    return silhouettes_.are_clear_of(places_[a], places_[b]) ||
           (is_open(a) && is_open(b) && !silhouettes_.pass_between(places_[a], places_[b]));
  }

 private:
  bool is_open(std::size_t i) {
    if (sees_[i] == kUnknown) sees_[i] = silhouettes_.in_penumbra(places_[i]) ? kPenumbra : kOpen;
    return sees_[i] == kOpen;
  }

  // Beside kBack and kGrazing.
  static constexpr std::uint8_t kUnknown = kFront, kOpen = kFront + 1, kPenumbra = kFront + 2;
  const SilhouetteGrid& silhouettes_;
  std::span<const glm::vec3> places_;
  std::span<std::uint8_t> sees_;
};

// A grid over an object as the light sees it. Silhouettes lower than its foot shade none of the
// object. Nothing for an object that is a point.
std::optional<LightGrid> grid_over(const Caster& object, const glm::dvec3& towards) {
  const Pose light_from_world =
                 Pose{glm::rotation(glm::dvec3(0, 1, 0), towards), {0, 0, 0}}.inverse(),
             light_from_mesh = light_from_world * object.world_from_mesh;
  const LightBox box =
      turned(object.silhouette->bounds(), glm::mat3(light_from_mesh.rotation_matrix()));
  const glm::vec3 size = box.high - box.low;
  const float cell =
      std::max(object.silhouette->mean_length_m(), std::max(size.x, size.z) / kMaxCells);
  if (!(cell > 0)) return std::nullopt;
  const Pose grid_from_light{{1, 0, 0, 0},
                             glm::dvec3(cell) - glm::dvec3(box.low) - light_from_mesh.translation};
  return LightGrid{grid_from_light * light_from_world, cell, static_cast<int>(size.x / cell) + 3,
                   static_cast<int>(size.z / cell) + 3};
}

}  // namespace

// By its sphere, which is never smaller than what find() looks at.
bool VisibilityGroups::counts_parts(const Caster& object, const lighting::DistantLight& source) {
  const double angle = largest_angle(source), across = 2 * double(object.silhouette->radius_m()),
               cell = std::max(double(object.silhouette->mean_length_m()), across / kMaxCells);
  return angle < kWidest && across * std::tan(angle) < cell;
}

void VisibilityGroups::find(const ShadowCasters& casters, const Caster& object,
                            const lighting::DistantLight& source, const SampleSet& samples) {
  const SilhouetteMesh& silhouette = *object.silhouette;
  const prt::Mesh& mesh = *object.mesh;
  group_.assign(mesh.positions.size(), kAlone);
  members_.clear();
  parts_.clear();
  may_be_cut_ = !silhouette.knows_cuts() || others_reach(casters.virtual_things, object) ||
                others_reach(casters.real_things, object);
  const bool hard = samples.directions.size() == 1;
  const double angle = hard ? 0 : largest_angle(source);
  if (angle > kWidest || silhouette.edges().empty()) return;
  const auto grid = grid_over(object, source.direction);
  if (!grid) return;
  const Scratch::Scope scope;
  places_.resize(mesh.positions.size());
  sides_.resize(mesh.positions.size());
  const glm::mat3 turn(object.world_from_mesh.rotation_matrix());
  const auto behind = -static_cast<float>(std::sin(angle)) - kCosineRounding;
  place_vertices(mesh.positions, mesh.normals, grid->from(object.world_from_mesh),
                 {glm::transpose(turn) * glm::vec3(source.direction), behind}, places_, sides_);
  std::ranges::transform(sides_, group_.begin(),
                         [](std::uint8_t side) { return side == kBack ? kTurnedAway : kAlone; });
  const DirectionCone cone = hard ? DirectionCone{source.direction, 0} : cone_of(source);
  SilhouetteCache& cache = cache_of(casters);
  const SilhouetteLines lines =
      lines_of(casters, object, places_, *grid, cone, cache, scope.memory());
  const SilhouetteGrid silhouettes(
      lines.lines, *grid, static_cast<float>(grid->cell_m / std::tan(std::max(angle, 1e-6))),
      scope.memory());
  VertexView view(places_, sides_, silhouettes);
  join_all(silhouette, cache.find(silhouette, object.world_from_mesh, cone).faces, view);
  if (hard || !silhouettes.has_lists()) return;
  for (std::size_t i = 0; i < group_.size(); ++i)
    if (group_[i] == kAlone) group_[i] = kInPart, parts_.push_back({i, {}});
  const glm::mat3 lift = grid->from({}).turn * casters.near_m * turn;
  parallel_for(std::size_t{0}, parts_.size(), 512, [&](const auto& some) {
    SoftShadowVolume part_seen(silhouettes, *grid, lines.caster_frames, samples);
    for (PartlyLit& part : std::span(parts_).subspan(some.begin(), some.size())) {
      const glm::vec3& normal = mesh.normals[part.vertex];
      part.seen = part_seen.find(places_[part.vertex], lift * normal, turn * normal);
    }
  });
}

// Edges come in the order of their higher vertex: the lower one has its group already.
template <class VertexView>
void VisibilityGroups::join_all(const SilhouetteMesh& silhouette,
                                std::span<const std::uint8_t> faces, VertexView& view) {
  // Of other triangles one end may lie in their own shadow.
  const auto is_in_front = [&](const SilhouetteMesh::Edge& e) {
    return faces[e.left] == kFacesAll ||
           (e.right != SilhouetteMesh::kOpen && faces[e.right] == kFacesAll);
  };
  for (std::size_t vertex = 0; vertex < group_.size(); ++vertex) {
    if (!view.may_join(vertex)) continue;
    const auto [begin, end] = silhouette.edges_down_from(vertex);
    for (std::uint32_t i = begin; i < end && view.may_join(vertex); ++i) {
      const SilhouetteMesh::Edge& edge = silhouette.edges()[i];
      const std::uint32_t lower = std::min(edge.from, edge.to);
      if (!view.may_join(lower) || !is_in_front(edge) || silhouette.is_cut(i) ||
          !view.see_alike(lower, vertex))
        continue;
      join(lower, static_cast<std::uint32_t>(vertex));
      break;
    }
  }
}

void VisibilityGroups::join(std::uint32_t first, std::uint32_t second) {
  if (group_[first] == kAlone) {
    group_[first] = static_cast<std::uint32_t>(groups());
    members_.insert(members_.end(), {first, second});
  }
  group_[second] = group_[first];
  members_[2 * group_[first] + 1] = second;
}

}  // namespace penumbra::shadows
