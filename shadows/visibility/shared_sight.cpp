#include "shadows/visibility/internal/shared_sight.h"

#include <algorithm>
#include <cmath>
#include <glm/gtx/quaternion.hpp>
#include <optional>

#include "prt/geometry/mesh.h"
#include "shadows/silhouette/outline_memo.h"
#include "shadows/silhouette/place_kernel.h"
#include "shadows/silhouette/projection_kernel.h"
#include "core/parallel.h"
#include "core/scratch.h"
#include "shadows/silhouette/disc_rays.h"
#include "shadows/visibility/internal/outline_grid.h"
#include "shadows/visibility/internal/part_seen.h"

namespace penumbra::shadows {

namespace {

constexpr float kMostCells = 192;  // across an object seen from the light
// Radians: of a wider disc most vertices see a part, and looking for the others costs more than their rays.
constexpr double kWidest = .15;
constexpr float kCosineRounding = 1e-5f;

struct Box {
  glm::vec3 low, high;
};
Box turned(const prt::Bounds& bounds, const glm::mat3& turn) {
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
class View {
 public:
  View(std::span<const glm::vec3> places, std::span<std::uint8_t> sides,
       const OutlineGrid& outlines)
      : outlines_(outlines), places_(places), sees_(sides) {}
  /// False of vertices whose middle of the disc is behind them, or known to lie in a penumbra.
  bool may_share(std::size_t i) const { return sees_[i] == kUnknown || sees_[i] == kOpen; }
  /// in: vertices that may share
  bool see_alike(std::size_t a, std::size_t b) {
    return outlines_.are_clear_of(places_[a], places_[b]) ||
           (is_open(a) && is_open(b) && !outlines_.pass_between(places_[a], places_[b]));
  }

 private:
  bool is_open(std::size_t i) {
    if (sees_[i] == kUnknown) sees_[i] = outlines_.in_penumbra(places_[i]) ? kPenumbra : kOpen;
    return sees_[i] == kOpen;
  }

  // Beside kBehind and kAslant.
  static constexpr std::uint8_t kUnknown = kBefore, kOpen = kBefore + 1, kPenumbra = kBefore + 2;
  const OutlineGrid& outlines_;
  std::span<const glm::vec3> places_;
  std::span<std::uint8_t> sees_;
};

// A grid over an object as the light sees it. Outlines lower than its foot shade none of the object. Nothing for an object that is a point.
std::optional<LightGrid> grid_over(const Caster& object, const glm::dvec3& towards) {
  const Pose light_from_world =
                 Pose{glm::rotation(glm::dvec3(0, 1, 0), towards), {0, 0, 0}}.inverse(),
             light_from_mesh = light_from_world * object.world_from_mesh;
  const Box box = turned(object.outline->bounds(), glm::mat3(light_from_mesh.rotation_matrix()));
  const glm::vec3 size = box.high - box.low;
  const float cell =
      std::max(object.outline->mean_length_m(), std::max(size.x, size.z) / kMostCells);
  if (!(cell > 0)) return std::nullopt;
  const Pose grid_from_light{{1, 0, 0, 0},
                             glm::dvec3(cell) - glm::dvec3(box.low) - light_from_mesh.translation};
  return LightGrid{grid_from_light * light_from_world, cell, static_cast<int>(size.x / cell) + 3,
                   static_cast<int>(size.z / cell) + 3};
}

}  // namespace

// By its sphere, which is never smaller than what find() looks at.
bool SharedSight::counts_parts(const Caster& object, const lighting::Disc& disc) {
  const double angle = largest_angle(disc), across = 2 * double(object.outline->radius_m()),
               cell = std::max(double(object.outline->mean_length_m()), across / kMostCells);
  return angle < kWidest && across * std::tan(angle) < cell;
}

void SharedSight::find(const Casters& casters, const Caster& object, const lighting::Disc& disc,
                       const Taps& taps) {
  const Outline& outline = *object.outline;
  const prt::Mesh& mesh = *object.mesh;
  group_.assign(mesh.positions.size(), kAlone);
  members_.clear();
  parts_.clear();
  may_be_cut_ = !outline.knows_cuts() || others_reach(casters.virtual_things, object) ||
                others_reach(casters.real_things, object);
  const bool hard = taps.directions.size() == 1;
  const double angle = hard ? 0 : largest_angle(disc);
  if (angle > kWidest || outline.edges().empty()) return;
  const auto grid = grid_over(object, disc.direction);
  if (!grid) return;
  const Scratch::Scope scope;
  places_.resize(mesh.positions.size());
  sides_.resize(mesh.positions.size());
  const glm::mat3 turn(object.world_from_mesh.rotation_matrix());
  const auto behind = -static_cast<float>(std::sin(angle)) - kCosineRounding;
  place_vertices(mesh.positions, mesh.normals, grid->from(object.world_from_mesh),
                 {glm::transpose(turn) * glm::vec3(disc.direction), behind}, places_, sides_);
  std::ranges::transform(sides_, group_.begin(),
                         [](std::uint8_t side) { return side == kBehind ? kTurnedAway : kAlone; });
  const Beam beam = hard ? Beam{disc.direction, 0} : beam_of(disc);
  OutlineMemo& memo = memo_of(casters);
  const Lines lines = lines_of(casters, object, places_, *grid, beam, memo, scope.memory());
  const OutlineGrid outlines(lines.lines, *grid,
                             static_cast<float>(grid->cell_m / std::tan(std::max(angle, 1e-6))),
                             scope.memory());
  View view(places_, sides_, outlines);
  join_all(outline, memo.find(outline, object.world_from_mesh, beam).faces, view);
  if (hard || !outlines.has_lists()) return;
  for (std::size_t i = 0; i < group_.size(); ++i)
    if (group_[i] == kAlone) group_[i] = kInPart, parts_.push_back({i, {}});
  const glm::mat3 lift = grid->from({}).turn * casters.near_m * turn;
  parallel_for(std::size_t{0}, parts_.size(), 512, [&](const auto& some) {
    PartSeen part_seen(outlines, *grid, lines.throwers, taps);
    for (Part& part : std::span(parts_).subspan(some.begin(), some.size())) {
      const glm::vec3& normal = mesh.normals[part.vertex];
      part.seen = part_seen.find(places_[part.vertex], lift * normal, turn * normal);
    }
  });
}

// Edges come in the order of their higher vertex: the lower one has its group already.
template <class View>
void SharedSight::join_all(const Outline& outline, std::span<const std::uint8_t> faces,
                           View& view) {
  // Of other triangles one end may lie in their own shadow.
  const auto is_in_front = [&](const Outline::Edge& e) {
    return faces[e.left] == kFacesAll || (e.right != Outline::kOpen && faces[e.right] == kFacesAll);
  };
  for (std::size_t vertex = 0; vertex < group_.size(); ++vertex) {
    if (!view.may_share(vertex)) continue;
    const auto [begin, end] = outline.edges_down_from(vertex);
    for (std::uint32_t i = begin; i < end && view.may_share(vertex); ++i) {
      const Outline::Edge& edge = outline.edges()[i];
      const std::uint32_t lower = std::min(edge.from, edge.to);
      if (!view.may_share(lower) || !is_in_front(edge) || outline.is_cut(i) ||
          !view.see_alike(lower, vertex))
        continue;
      join(lower, static_cast<std::uint32_t>(vertex));
      break;
    }
  }
}

void SharedSight::join(std::uint32_t first, std::uint32_t second) {
  if (group_[first] == kAlone) {
    group_[first] = static_cast<std::uint32_t>(groups());
    members_.insert(members_.end(), {first, second});
  }
  group_[second] = group_[first];
  members_[2 * group_[first] + 1] = second;
}

}  // namespace penumbra::shadows
