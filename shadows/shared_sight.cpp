#include "shadows/shared_sight.h"

#include <algorithm>
#include <cmath>
#include <glm/gtx/quaternion.hpp>

#include "core/scratch.h"
#include "shadows/disc_rays.h"
#include "shadows/outline_sides.h"

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

// Signed area of the parallelogram of two vectors.
float cross(const glm::vec2& a, const glm::vec2& b) {
  return a.x * b.y - a.y * b.x;
}
glm::vec2 across(const glm::vec3& p) {
  return {p.x, p.z};
}

// Whether the side passes over the way from a to b. Ways that begin or end on it are not passed over: an outline's own
// surface touches it. (Both come by the same sums from the same vertex, so that they are equal where they should be.)
bool passes_over(const Side& side, const glm::vec3& a, const glm::vec3& b) {
  const glm::vec2 from = across(side.from), along = across(side.to) - from, start = across(a),
                  way = across(b) - start;
  const float a_off = cross(along, start - from), b_off = cross(along, across(b) - from);
  if (!(a_off < 0 ? b_off > 0 : a_off > 0 && b_off < 0)) return false;
  const float from_off = cross(way, from - start), to_off = cross(way, across(side.to) - start);
  if ((from_off < 0 && to_off < 0) || (from_off > 0 && to_off > 0)) return false;
  const float on_way = a_off / (a_off - b_off),
              on_side = from_off == to_off ? 0 : from_off / (from_off - to_off);
  return glm::mix(side.from.y, side.to.y, on_side) > glm::mix(a.y, b.y, on_way);
}

// Where outlines pass over a grid seen from the light.
class Outlines {
 public:
  /// `drop`: metres below an outline at which the disc throws its shadow aside by a cell.
  Outlines(std::span<const Side> sides, int width, int depth, float drop,
           std::pmr::memory_resource* memory)
      : sides_(sides),
        width_(width),
        depth_(depth),
        drop_(drop),
        height_(static_cast<std::size_t>(width * depth), -1e30f, memory),
        last_(memory),
        listed_(memory) {
    std::size_t covered = 0;
    for (const Side& side : sides)
      each_cell(side, [&](std::size_t cell, float height) {
        height_[cell] = std::max(height_[cell], height);
        highest_ = std::max(highest_, height);
        ++covered;
      });
    constexpr std::size_t kMostOverACell =
        32;  // in the mean: blinds of long slats would fill lists
    if (highest_ < drop && covered <= kMostOverACell * height_.size())
      list_sides();
    else
      spread();
  }

  /// Whether an outline hides a part of the disc only. False where pass_between() tells it of every way from there.
  bool in_penumbra(const glm::vec3& p) const {
    const glm::vec2 place = across(p);
    return any_side(p, p, [&](const Side& side) {
      const glm::vec2 from = across(side.from), along = across(side.to) - from;
      const float square = glm::dot(along, along),
                  nearest =
                      square > 0 ? std::clamp(glm::dot(place - from, along) / square, 0.f, 1.f) : 0;
      // What is higher reaches farther.
      for (const float t : {nearest, 0.f, 1.f}) {
        const float above = glm::mix(side.from.y, side.to.y, t) - p.y,
                    reach = above / drop_ + kRounding;
        const glm::vec2 off = place - (from + t * along);
        if (above > 0 && glm::dot(off, off) < reach * reach) return true;
      }
      return false;
    });
  }
  /// in: places within the grid
  bool pass_between(const glm::vec3& a, const glm::vec3& b) const {
    if (last_.empty()) return any_cell(a, b, [](std::size_t) { return true; });
    return any_side(a, b, [&](const Side& side) { return passes_over(side, a, b); });
  }

 private:
  static constexpr float kRounding = .02f;  // cells
  struct Listed {
    std::uint32_t side, before;
  };
  static constexpr std::uint32_t kNone = 0xffffffffu;

  // f(cell, height): how near to the light something has to be there that the side does not pass between it and any part
  // of the disc.
  template <class F>
  void each_cell(const Side& side, F f) const {
    const float height = std::max(side.from.y, side.to.y), reach = std::min(1.f, height / drop_);
    const glm::vec2 a(across(side.from)), b(across(side.to)),
        end(static_cast<float>(width_) - 1, static_cast<float>(depth_) - 1),
        low = glm::min(a, b) - reach, high = glm::max(a, b) + reach;
    // What lies aside of the grid comes in so many cells further down, and as much broader.
    const glm::vec2 off = glm::max(glm::max(low - end, -high), 0.f);
    const float aside = std::max(off.x, off.y), here = height - drop_ * aside;
    if (!(here > 0 && aside < 1e9f)) return;
    const glm::ivec2 first(glm::clamp(low - aside, glm::vec2(0), end)),
        last(glm::clamp(high + aside, glm::vec2(0), end));
    for (int z = first.y; z <= last.y; ++z)
      for (int x = first.x; x <= last.x; ++x) f(index(x, z), here);
  }
  void list_sides() {
    last_.assign(height_.size(), kNone);
    for (std::uint32_t i = 0; i < sides_.size(); ++i)
      each_cell(sides_[i], [&](std::size_t cell, float) {
        listed_.push_back({i, last_[cell]});
        last_[cell] = static_cast<std::uint32_t>(listed_.size() - 1);
      });
  }
  // Below an outline the light comes from aside as well: cells further off are passed over lower down. Steps go aslant too,
  // so that no cell is left out.
  void spread() {
    if (highest_ < drop_) return;  // as far as a cell around it is marked
    for (int z = 0; z < depth_; ++z)
      for (int x = 0; x < width_; ++x) lift(x, z, -1);
    for (int z = depth_ - 1; z >= 0; --z)
      for (int x = width_ - 1; x >= 0; --x) lift(x, z, 1);
  }
  // From the neighbours that come earlier on the way.
  void lift(int x, int z, int way) {
    float& here = height_[index(x, z)];
    const auto from = [&](int i, int j) {
      if (i >= 0 && i < width_ && j >= 0 && j < depth_)
        here = std::max(here, height_[index(i, j)] - drop_);
    };
    from(x + way, z);
    for (int i = -1; i <= 1; ++i) from(x + i, z + way);
  }

  // Whether f(cell) is true for a cell between the places over which an outline passes.
  template <class F>
  bool any_cell(const glm::vec3& a, const glm::vec3& b, F f) const {
    const glm::vec3 low = glm::min(a, b), high = glm::max(a, b);
    for (int z = static_cast<int>(low.z); z <= static_cast<int>(high.z); ++z)
      for (int x = static_cast<int>(low.x); x <= static_cast<int>(high.x); ++x)
        if (height_[index(x, z)] >= low.y && f(index(x, z))) return true;
    return false;
  }
  template <class F>
  bool any_side(const glm::vec3& a, const glm::vec3& b, F f) const {
    if (last_.empty()) return false;
    return any_cell(a, b, [&](std::size_t cell) {
      for (std::uint32_t i = last_[cell]; i != kNone; i = listed_[i].before)
        if (f(sides_[listed_[i].side])) return true;
      return false;
    });
  }
  std::size_t index(int x, int z) const { return static_cast<std::size_t>(z * width_ + x); }

  std::span<const Side> sides_;
  int width_, depth_;
  float drop_, highest_ = 0;
  std::pmr::vector<float> height_;
  // Where no shadow is thrown aside by a cell: the sides over each cell, from its last one back.
  std::pmr::vector<std::uint32_t> last_;
  std::pmr::vector<Listed> listed_;
};

// A sun's middle stands for all of it: edges that are an outline for a part of it alone lie less than a cell off, on what
// is no higher than the object. `cells`: by how much the disc throws the shadow of the object's top aside.
std::pmr::vector<PlaneTap> taps_around(const lighting::Disc& disc, float cells,
                                       const Pose& world_from_light,
                                       std::pmr::memory_resource* memory) {
  constexpr int kTaps = 16;
  std::pmr::vector<PlaneTap> out(memory);
  out.push_back({{0, 0}, 1});
  constexpr double kThin = .01;  // radians
  if (cells < 1 && largest_angle(disc) < kThin) return out;
  thread_local TapPattern pattern;  // grows once per thread
  pattern.make(disc, kTaps, 1);
  const Pose light_from_world = world_from_light.inverse();
  for (const glm::vec3& direction : pattern.at(0)) {
    const glm::dvec3 d = light_from_world * glm::dvec3(direction);
    out.push_back({-glm::dvec2(d.x, d.z) / d.y, 1});
  }
  return out;
}

}  // namespace

void SharedSight::find(const Casters& casters, const Caster& object, const lighting::Disc& disc) {
  const std::vector<glm::vec3>& positions = object.mesh->positions;
  group_.assign(positions.size(), kAlone);
  count_ = 0;
  const double angle = largest_angle(disc);
  if (angle > kWidest || object.outline->edges().empty()) return;
  const Scratch::Scope scope;
  // y towards the light.
  const Pose world_from_light{glm::rotation(glm::dvec3(0, 1, 0), disc.direction), {0, 0, 0}},
      light_from_mesh = world_from_light.inverse() * object.world_from_mesh;
  const glm::mat3 turn(light_from_mesh.rotation_matrix());
  const Box box = turned(object.outline->bounds(), turn);
  const glm::vec3 size = box.high - box.low;
  const float cell =
      std::max(object.outline->mean_length_m(), std::max(size.x, size.z) / kMostCells);
  if (!(cell > 0)) return;
  // Outlines lower than all of the object shade none of it.
  const NodeGrid grid{
      world_from_light *
          Pose{{1, 0, 0, 0}, light_from_mesh.translation + glm::dvec3(box.low) - glm::dvec3(cell)},
      cell};
  const auto drop = static_cast<float>(cell / std::tan(std::max(angle, 1e-6)));
  const std::pmr::vector<PlaneTap> taps =
      taps_around(disc, size.y / drop, world_from_light, scope.memory());
  std::pmr::vector<Side> sides = find_sides(casters.virtual_things, grid, 0, taps, scope.memory());
  for (const Side& side : find_sides(casters.real_things, grid, 0, taps, scope.memory()))
    sides.push_back(side);
  const Outlines outlines(sides, static_cast<int>(size.x / cell) + 3,
                          static_cast<int>(size.z / cell) + 3, drop, scope.memory());
  std::pmr::vector<glm::vec3> places(positions.size(), scope.memory());  // of open vertices
  std::pmr::vector<char> open(positions.size(), scope.memory());
  const glm::vec3 towards =
                      glm::transpose(object.world_from_mesh.rotation_matrix()) * disc.direction,
                  scale(1 / cell, 1, 1 / cell), start = box.low - cell;
  const auto behind = -static_cast<float>(std::sin(angle)) - kCosineRounding;
  for (std::size_t i = 0; i < places.size(); ++i) {
    const float cosine = glm::dot(object.mesh->normals[i], towards);
    if (cosine < behind) group_[i] = kTurnedAway;
    if (cosine <= 0) continue;
    places[i] = scale * (turn * positions[i] - start);
    open[i] = !outlines.in_penumbra(places[i]);
  }
  // Edges come in the order of their lower vertex: it has its group when its edges to others come.
  for (std::size_t p = 0; p < object.outline->patches().size(); ++p) {
    const Outline::Patch& patch = object.outline->patches()[p];
    if (glm::dot(patch.axis, towards) < -patch.sine) continue;
    for (const Outline::Edge& e : object.outline->edges_of(p)) {
      const std::uint32_t first = std::min(e.from, e.to), second = std::max(e.from, e.to);
      if (!open[first] || !open[second] || group_[second] != kAlone) continue;
      if (outlines.pass_between(places[first], places[second])) continue;
      if (group_[first] == kAlone) group_[first] = static_cast<std::uint32_t>(count_++);
      group_[second] = group_[first];
    }
  }
}

}  // namespace penumbra::shadows
