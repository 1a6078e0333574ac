#include "shadows/visibility/internal/silhouette_grid.h"

#include <algorithm>
#include <cmath>

#include "core/threads/background_task.h"

namespace penumbra::shadows {

namespace {

// What is long covers many cells aside of it and has many heights.
void add_parts(const SilhouetteLine& line, std::pmr::vector<SilhouetteLine>& out) {
  constexpr float kLong = 16, kMaxParts = 64;  // cells
  const glm::vec3 way = line.to - line.from;
  const float parts =
      std::clamp(std::ceil(std::max(std::abs(way.x), std::abs(way.z)) / kLong), 1.f, kMaxParts);
  glm::vec3 from = line.from;
  for (float k = 1; k <= parts; ++k) {
    const glm::vec3 to = k == parts ? line.to : line.from + k / parts * way;
    out.push_back({from, to, line.caster_frame, line.edge});
    from = to;
  }
}

// Signed area of the parallelogram of two vectors.
float cross(const glm::vec2& a, const glm::vec2& b) {
  return a.x * b.y - a.y * b.x;
}

glm::vec2 across(const glm::vec3& p) {
  return {p.x, p.z};
}

// Whether the line passes over the way from a to b. Ways that begin or end on it are not passed
// over: a silhouette's own surface touches it. (Both come by the same sums from the same vertex, so
// that they are equal where they should be.)
bool passes_over(const SilhouetteLine& line, const glm::vec3& a, const glm::vec3& b) {
  const glm::vec2 from = across(line.from), along = across(line.to) - from, start = across(a),
                  way = across(b) - start;
  const float a_off = cross(along, start - from), b_off = cross(along, across(b) - from);
  if (!(a_off < 0 ? b_off > 0 : a_off > 0 && b_off < 0)) return false;
  const float from_off = cross(way, from - start), to_off = cross(way, across(line.to) - start);
  if ((from_off < 0 && to_off < 0) || (from_off > 0 && to_off > 0)) return false;
  const float on_way = a_off / (a_off - b_off),
              on_line = from_off == to_off ? 0 : from_off / (from_off - to_off);
  return glm::mix(line.from.y, line.to.y, on_line) > glm::mix(a.y, b.y, on_way);
}

}  // namespace

AffineTransform LightGrid::from(const Pose& world_from_mesh) const {
  const Pose place = grid_from_world * world_from_mesh;
  const glm::mat3 scale(glm::vec3(1 / cell_m, 0, 0), glm::vec3(0, 1, 0),
                        glm::vec3(0, 0, 1 / cell_m));
  return {scale * glm::mat3(place.rotation_matrix()), scale * glm::vec3(place.translation)};
}

SilhouetteLines lines_of(const ShadowCasters& casters, const Caster& object,
                         std::span<const glm::vec3> places, const LightGrid& grid,
                         const DirectionCone& cone, SilhouetteCache& cache,
                         std::pmr::memory_resource* memory) {
  SilhouetteLines out{std::pmr::vector<SilhouetteLine>(memory),
                      std::pmr::vector<CasterFrame>(memory)};
  const auto add = [&](const Caster& c) {
    const AffineTransform placing = grid.from(c.world_from_mesh);
    // The object itself, and a copy in its place.
    const bool same_pose = c.world_from_mesh == object.world_from_mesh;
    const auto place = [&](std::uint32_t vertex) {
      const glm::vec3& p = c.mesh->positions[vertex];
      const bool same = same_pose && vertex < places.size() && p == object.mesh->positions[vertex];
      return same ? places[vertex] : placing.turn * p + placing.shift;
    };
    const auto caster_frame = static_cast<std::uint32_t>(out.caster_frames.size());
    out.caster_frames.push_back({c.silhouette, glm::transpose(glm::inverse(placing.turn))});
    for (const std::uint32_t i : cache.find(*c.silhouette, c.world_from_mesh, cone).edges) {
      const SilhouetteMesh::Edge& e = c.silhouette->edges()[i];
      const SilhouetteLine line{place(e.from), place(e.to), caster_frame, i};
      if (line.from.y > 0 || line.to.y > 0) add_parts(line, out.lines);
    }
  };
  for (const Caster& c : casters.virtual_things) add(c);
  for (const Caster& c : casters.real_things) add(c);
  return out;
}

SilhouetteGrid::SilhouetteGrid(std::span<const SilhouetteLine> lines, const LightGrid& grid,
                               float drop, std::pmr::memory_resource* memory)
    : lines_(lines),
      width_(grid.width),
      depth_(grid.depth),
      drop_(drop),
      per_drop_(1 / drop),
      height_(static_cast<std::size_t>(grid.width * grid.depth), -1e30f, memory),
      last_(memory),
      listed_(memory) {
  last_.assign(2 * height_.size(), kNone);
  for (std::uint32_t i = 0; i < lines_.size(); ++i)
    each_cell(lines_[i], [&](std::size_t cell, float height, bool over) {
      height_[cell] = std::max(height_[cell], height);
      list(i, over ? kOver : kBeside, cell, height);
    });
  if (last_.empty()) spread();
}

bool SilhouetteGrid::in_penumbra(const glm::vec3& p) const {
  if (last_.empty()) return false;
  const std::size_t cell = index(static_cast<int>(p.x), static_cast<int>(p.z));
  if (height_[cell] < p.y) return false;
  const auto hides_a_part = [&](const SilhouetteLine& line) {
    if (!may_reach(line, p)) return false;
    const glm::vec2 to_place = across(p) - across(line.from),
                    along = across(line.to) - across(line.from);
    const float square = glm::dot(along, along),
                nearest = square > 0 ? std::clamp(glm::dot(to_place, along) / square, 0.f, 1.f) : 0;
    // What is higher reaches farther.
    for (const float t : {nearest, 0.f, 1.f}) {
      const float above = glm::mix(line.from.y, line.to.y, t) - p.y,
                  reach = above * per_drop_ + kRounding;
      const glm::vec2 off = to_place - t * along;
      if (above > 0 && glm::dot(off, off) < reach * reach) return true;
    }
    return false;
  };
  return any_line(cell, kOver, p.y, hides_a_part) || any_line(cell, kBeside, p.y, hides_a_part);
}

bool SilhouetteGrid::pass_between(const glm::vec3& a, const glm::vec3& b) const {
  if (last_.empty()) return !are_clear_of(a, b);
  return any_cell(a, b, [&](std::size_t cell) {
    return any_line(cell, kOver, std::min(a.y, b.y),
                    [&](const SilhouetteLine& line) { return passes_over(line, a, b); });
  });
}

// f(cell, height, over): how near to the light something has to be there that the line does not
// pass between it and any part of the light: where it is not over the cell itself only what is
// lower down is passed over.
template <class F>
void SilhouetteGrid::each_cell(const SilhouetteLine& line, F f) const {
  const float height = std::max(line.from.y, line.to.y), reach = std::min(1.f, height / drop_);
  const glm::vec2 a(across(line.from)), b(across(line.to)),
      low = glm::min(a, b), high = glm::max(a, b),
      end(static_cast<float>(width_) - 1, static_cast<float>(depth_) - 1);
  // What lies aside of the grid comes in at its rim.
  const glm::vec2 off = glm::max(glm::max(low - reach - end, -high - reach), 0.f);
  const float aside = std::max(off.x, off.y);
  if (!(height > drop_ * aside && aside < 1e9f)) return;
  const glm::ivec2 first(glm::clamp(low - reach - aside, glm::vec2(0), end)),
      last(glm::clamp(high + reach + aside, glm::vec2(0), end));
  for (int z = first.y; z <= last.y; ++z)
    for (int x = first.x; x <= last.x; ++x) {
      const glm::vec2 cell(x, z),
          apart = glm::max(glm::max(low - cell - 1.f, cell - high), kRounding) - kRounding;
      const float here = height - drop_ * std::max(apart.x, apart.y);
      if (here > 0) f(index(x, z), here, here == height);
    }
}
void SilhouetteGrid::list(std::uint32_t line, Where where, std::size_t cell, float height) {
  // Over a cell in the mean: blinds of long slats would fill lists
  constexpr std::size_t kMax = 32;
  // What is so high reaches farther than the cells in which it is listed.
  if (height >= drop_ || listed_.size() > kMax * height_.size()) last_.clear();
  if (last_.empty()) return;
  listed_.push_back({line, last_[2 * cell + where], height});
  last_[2 * cell + where] = static_cast<std::uint32_t>(listed_.size() - 1);
}
// Below a silhouette the light comes from aside as well: cells further off are passed over lower
// down. Steps go aslant too, so that no cell is left out.
void SilhouetteGrid::spread() {
  for (int z = 0; z < depth_; ++z)
    for (int x = 0; x < width_; ++x) lift(x, z, -1);
  for (int z = depth_ - 1; z >= 0; --z)
    for (int x = width_ - 1; x >= 0; --x) lift(x, z, 1);
}
// From the neighbours that come earlier on the way.
void SilhouetteGrid::lift(int x, int z, int way) {
  float& here = height_[index(x, z)];
  const auto from = [&](int i, int j) {
    if (i >= 0 && i < width_ && j >= 0 && j < depth_)
      here = std::max(here, height_[index(i, j)] - drop_);
  };
  from(x + way, z);
  for (int i = -1; i <= 1; ++i) from(x + i, z + way);
}

}  // namespace penumbra::shadows
