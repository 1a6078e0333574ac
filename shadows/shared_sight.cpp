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

struct Box {
  glm::vec3 low{1e30f}, high{-1e30f};
};

// Of each cell how near to the light something has to be that no outline passes between it and any part of the disc.
class OutlineHeights {
 public:
  /// `drop`: metres below an outline at which the disc throws its shadow aside by a cell.
  OutlineHeights(int width, int depth, float drop, std::pmr::memory_resource* memory)
      : width_(width),
        depth_(depth),
        drop_(drop),
        height_(static_cast<std::size_t>(width * depth), -1e30f, memory) {}

  void add(const Side& side) {
    const float height = std::max(side.from.y, side.to.y), reach = std::min(1.f, height / drop_);
    const glm::vec2 a(side.from.x, side.from.z), b(side.to.x, side.to.z),
        end(static_cast<float>(width_) - 1, static_cast<float>(depth_) - 1),
        low = glm::min(a, b) - reach, high = glm::max(a, b) + reach;
    // What lies aside of the grid comes in so many cells further down, and as much broader.
    const glm::vec2 off = glm::max(glm::max(low - end, -high), 0.f);
    const float aside = std::max(off.x, off.y), here = height - drop_ * aside;
    if (!(here > 0 && aside < 1e9f)) return;
    highest_ = std::max(highest_, here);
    const glm::ivec2 first(glm::clamp(low - aside, glm::vec2(0), end)),
        last(glm::clamp(high + aside, glm::vec2(0), end));
    for (int z = first.y; z <= last.y; ++z)
      for (int x = first.x; x <= last.x; ++x) at(x, z) = std::max(at(x, z), here);
  }
  /// Below an outline the light comes from aside as well: cells further off are passed over lower down. Steps go aslant too,
  /// so that no cell is left out.
  void spread() {
    if (highest_ < drop_) return;  // as far as a cell around it is marked
    for (int z = 0; z < depth_; ++z)
      for (int x = 0; x < width_; ++x) lift(x, z, -1);
    for (int z = depth_ - 1; z >= 0; --z)
      for (int x = width_ - 1; x >= 0; --x) lift(x, z, 1);
  }
  /// in: places within the grid
  bool pass_between(const glm::vec3& a, const glm::vec3& b) const {
    const glm::vec3 low = glm::min(a, b), high = glm::max(a, b);
    for (int z = static_cast<int>(low.z); z <= static_cast<int>(high.z); ++z)
      for (int x = static_cast<int>(low.x); x <= static_cast<int>(high.x); ++x)
        if (height_[static_cast<std::size_t>(z * width_ + x)] >= low.y) return true;
    return false;
  }

 private:
  // From the neighbours that come earlier on the way.
  void lift(int x, int z, int way) {
    float& here = at(x, z);
    const auto from = [&](int i, int j) {
      if (i >= 0 && i < width_ && j >= 0 && j < depth_) here = std::max(here, at(i, j) - drop_);
    };
    from(x + way, z);
    for (int i = -1; i <= 1; ++i) from(x + i, z + way);
  }
  float& at(int x, int z) { return height_[static_cast<std::size_t>(z * width_ + x)]; }

  int width_, depth_;
  float drop_, highest_ = 0;
  std::pmr::vector<float> height_;
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
  std::pmr::vector<glm::vec3> places(scope.memory());
  places.reserve(positions.size());
  Box box;
  for (const glm::vec3& p : positions) {
    places.push_back(turn * p);
    box.low = glm::min(box.low, places.back());
    box.high = glm::max(box.high, places.back());
  }
  const glm::vec3 size = box.high - box.low;
  const float cell =
      std::max(object.outline->mean_length_m(), std::max(size.x, size.z) / kMostCells);
  if (!(cell > 0)) return;
  // Outlines lower than all of the object shade none of it.
  const NodeGrid grid{
      world_from_light *
          Pose{{1, 0, 0, 0}, light_from_mesh.translation + glm::dvec3(box.low) - glm::dvec3(cell)},
      cell};
  for (glm::vec3& p : places) {
    p -= box.low - glm::vec3(cell);
    p.x /= cell, p.z /= cell;
  }
  const auto drop = static_cast<float>(cell / std::tan(std::max(angle, 1e-6)));
  OutlineHeights outlines(static_cast<int>(size.x / cell) + 3, static_cast<int>(size.z / cell) + 3,
                          drop, scope.memory());
  const std::pmr::vector<PlaneTap> taps =
      taps_around(disc, size.y / drop, world_from_light, scope.memory());
  for (const std::span<const Caster> things : {casters.virtual_things, casters.real_things})
    for (const Side& side : find_sides(things, grid, 0, taps, scope.memory())) outlines.add(side);
  outlines.spread();
  std::pmr::vector<char> open(positions.size(), scope.memory());
  const glm::vec3 towards =
      glm::transpose(object.world_from_mesh.rotation_matrix()) * disc.direction;
  for (std::size_t i = 0; i < places.size(); ++i)
    open[i] = glm::dot(object.mesh->normals[i], towards) > 0;
  // Edges come in the order of their lower vertex: it has its group when its edges to others come.
  for (const Outline::Edge& e : object.outline->edges()) {
    const std::uint32_t first = std::min(e.from, e.to), second = std::max(e.from, e.to);
    if (!open[first] || !open[second] || group_[second] != kAlone) continue;
    if (outlines.pass_between(places[first], places[second])) continue;
    if (group_[first] == kAlone) group_[first] = static_cast<std::uint32_t>(count_++);
    group_[second] = group_[first];
  }
}

}  // namespace penumbra::shadows
