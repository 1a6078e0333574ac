#include "shadows/part_seen.h"

#include <algorithm>
#include <cassert>
#include <cmath>

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
    : outlines_(outlines), throwers_(throwers), taps_(taps) {
  assert(taps.directions.size() <= kMostTaps);
  const glm::mat3 turn(grid.grid_from_world.rotation_matrix());
  const std::size_t count = taps.directions.size();
  for (std::size_t k = 0; k < count; ++k) {
    const glm::vec3& tap = taps.directions[k];
    towards_x_[k] = tap.x, towards_y_[k] = tap.y, towards_z_[k] = tap.z;
    const glm::vec3 d = turn * tap;
    x_[k] = d.x / (d.y * grid.cell_m), z_[k] = d.z / (d.y * grid.cell_m);
    reach_ = std::max({reach_, std::abs(x_[k]), std::abs(z_[k])});
  }
  // What is right above a place in a scene of right angles goes through the middle, and through taps beside it.
  middle_ = reach_ * glm::vec2(.0371f, .0237f);
  for (std::size_t k = 0; k < count; ++k) x_[k] -= middle_.x, z_[k] -= middle_.y;
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
  const float layers = (open ? 1.f : 2.f) * (left ? -1.f : 1.f);
  const glm::vec2 way = to - from;
  const float middle_off = cross(from, way);
  const std::size_t count = taps_.directions.size();
  for (std::size_t k = 0; k < count; ++k) {
    const float from_off = x_[k] * from.y - z_[k] * from.x, to_off = x_[k] * to.y - z_[k] * to.x,
                tap_off = way.x * (z_[k] - from.y) - way.y * (x_[k] - from.x);
    const float passed = (from_off >= 0) != (to_off >= 0) ? layers : 0.f,
                sign = tap_off > 0 ? 1.f : -1.f;
    layers_[k] += (tap_off > 0) != (middle_off > 0) ? passed * sign : 0.f;
  }
}

PartSeen::Answer PartSeen::find(const glm::vec3& place, const glm::vec3& lift,
                                const glm::vec3& normal) {
  const std::size_t count = taps_.directions.size();
  for (std::size_t k = 0; k < count; ++k) {
    layers_[k] = 0;
    cosine_[k] = std::max(
        0.f, normal.x * towards_x_[k] + normal.y * towards_y_[k] + normal.z * towards_z_[k]);
  }
  outlines_.each_over(place, [&](const Line& line) { add(line, place + lift); });
  float fewest = 1e30f;
  for (std::size_t k = 0; k < count; ++k)
    if (cosine_[k] > 0) fewest = std::min(fewest, layers_[k]);
  Answer out;
  glm::vec3 sum(0);  // of the taps alike, and their number
  for (std::size_t k = 0; k < count; ++k) {
    out.open += cosine_[k];
    if (cosine_[k] <= 0 || layers_[k] != fewest) continue;
    sum += glm::vec3(x_[k], z_[k], 1);
    if ((taps_.counted >> k & 1) != 0) out.seen += cosine_[k];
  }
  const float share = 1 / static_cast<float>(count);
  out.open *= share, out.seen *= share;
  out.ask = nearest_alike(fewest, glm::vec2(sum.x, sum.y) / sum.z);
  return out;
}

// Amid those that are alike: beside an outline rounding could tell rays and layers apart.
std::uint32_t PartSeen::nearest_alike(float layers, const glm::vec2& at) const {
  std::uint32_t out = 0;
  float least = 1e30f;
  for (std::uint32_t k = 0; k < taps_.directions.size(); ++k) {
    const glm::vec2 off = glm::vec2(x_[k], z_[k]) - at;
    if (cosine_[k] <= 0 || layers_[k] != layers || glm::dot(off, off) >= least) continue;
    least = glm::dot(off, off);
    out = k;
  }
  return out;
}

}  // namespace penumbra::shadows
