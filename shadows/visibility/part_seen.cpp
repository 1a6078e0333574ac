#include "shadows/visibility/internal/part_seen.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "shadows/silhouette/disc_rays.h"
#include "shadows/silhouette/outline.h"

namespace penumbra::shadows {

namespace {

// Seen from the place: what is at its height or lower is thrown away from the disc, and cut off a little above.
glm::vec2 seen(const glm::vec3& end, const glm::vec3& other) {
  constexpr float kLeast = 1e-3f;  // of the other end's height
  const float least = kLeast * other.y;
  const glm::vec3 p =
      end.y >= least ? end : glm::mix(other, end, (other.y - least) / (other.y - end.y));
  return glm::vec2(p.x, p.z) / p.y;
}

}  // namespace

PartSeen::PartSeen(const OutlineGrid& outlines, const LightGrid& grid,
                   std::span<const Thrower> throwers, const Taps& taps)
    : outlines_(outlines), throwers_(throwers) {
  assert(taps.directions.size() <= kMostTaps);
  const glm::mat3 turn(grid.grid_from_world.rotation_matrix());
  taps_.count = taps.directions.size();
  for (std::size_t k = 0; k < taps_.count; ++k) {
    const glm::vec3& tap = taps.directions[k];
    taps_.towards_x[k] = tap.x, taps_.towards_y[k] = tap.y, taps_.towards_z[k] = tap.z;
    taps_.counted[k] = (taps.counted >> k & 1) != 0 ? 1 : 0;
    const glm::vec3 d = turn * tap;
    taps_.x[k] = d.x / (d.y * grid.cell_m), taps_.z[k] = d.z / (d.y * grid.cell_m);
    reach_ = std::max({reach_, std::abs(taps_.x[k]), std::abs(taps_.z[k])});
  }
  // What is right above a place in a scene of right angles goes through the middle, and through taps beside it.
  middle_ = reach_ * glm::vec2(.0371f, .0237f);
  for (std::size_t k = 0; k < taps_.count; ++k) taps_.x[k] -= middle_.x, taps_.z[k] -= middle_.y;
}

void PartSeen::add(const Line& line, const glm::vec3& place) {
  const glm::vec3 a = line.from - place, b = line.to - place;
  if (std::max(a.y, b.y) <= 0) return;
  const glm::vec2 from = seen(a, b) - middle_, to = seen(b, a) - middle_, low = glm::min(from, to),
                  high = glm::max(from, to);
  const float most = 1.05f * reach_;
  if (std::max(low.x, low.y) > most || std::min(high.x, high.y) < -most) return;
  const Thrower& thrower = throwers_[line.thrower];
  const Outline::Edge& edge = thrower.outline->edges()[line.edge];
  const auto faces = [&](std::uint32_t triangle) {
    const Outline::Normals& n = thrower.outline->normals();
    const glm::vec3 normal(n.x[triangle], n.y[triangle], n.z[triangle]);
    return glm::dot(thrower.turn_normals * normal, a) > 0;
  };
  const bool left = faces(edge.left), open = edge.right == Outline::kOpen;
  if (!open && faces(edge.right) == left) return;
  // The left triangle lies on the side of negative areas where it faces the light.
  add_layers({from, to, (open ? 1.f : 2.f) * (left ? -1.f : 1.f)}, taps_);
}

PartSeen::Answer PartSeen::find(const glm::vec3& place, const glm::vec3& lift,
                                const glm::vec3& normal) {
  begin_place(normal, taps_);
  outlines_.each_over(place, [&](const Line& line) { add(line, place + lift); });
  const FewestLayers fewest = fewest_layers(taps_);
  const float share = 1 / static_cast<float>(taps_.count);
  return {share * fewest.open, share * fewest.seen, fewest.ask};
}

}  // namespace penumbra::shadows
