#include "shadows/shared_sight.h"

#include <algorithm>
#include <cmath>
#include <glm/gtx/quaternion.hpp>

#include "core/scratch.h"
#include "shadows/outline_sides.h"

namespace penumbra::shadows {

namespace {

constexpr float kMostCells = 512;  // across an object seen from the light

struct Box {
  glm::vec3 low{1e30f}, high{-1e30f};
};

// Of each cell how near to the light the nearest outline is that may pass over it.
class OutlineHeights {
 public:
  OutlineHeights(int width, int depth, std::pmr::memory_resource* memory)
      : width_(width),
        depth_(depth),
        height_(static_cast<std::size_t>(width * depth), -1e30f, memory) {}

  /// `slope`: how far aside of its middle the disc throws an outline's shadow, cells for each metre below it.
  void add(const Side& side, float slope) {
    const float height = std::max(side.from.y, side.to.y), reach = slope * height;
    const int x0 = cell(std::min(side.from.x, side.to.x) - reach, width_),
              x1 = cell(std::max(side.from.x, side.to.x) + reach + 1, width_),
              z0 = cell(std::min(side.from.z, side.to.z) - reach, depth_),
              z1 = cell(std::max(side.from.z, side.to.z) + reach + 1, depth_);
    for (int z = z0; z < z1; ++z)
      for (int x = x0; x < x1; ++x) {
        float& at = height_[static_cast<std::size_t>(z * width_ + x)];
        at = std::max(at, height);
      }
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
  static int cell(float x, int limit) {
    return static_cast<int>(std::min(std::max(0.f, x), static_cast<float>(limit)));
  }

  int width_, depth_;
  std::pmr::vector<float> height_;
};

}  // namespace

void SharedSight::find(const Casters& casters, const Caster& object, const lighting::Disc& disc) {
  const std::vector<glm::vec3>& positions = object.mesh->positions;
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
  group_.assign(positions.size(), kAlone);
  count_ = 0;
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
  OutlineHeights outlines(static_cast<int>(size.x / cell) + 3, static_cast<int>(size.z / cell) + 3,
                          scope.memory());
  const PlaneTap straight{{0, 0}, 1};
  const float slope = static_cast<float>(std::tan(disc.radius.value())) / cell;
  for (const std::span<const Caster> things : {casters.virtual_things, casters.real_things})
    for (const Side& side : find_sides(things, grid, 0, {&straight, 1}, scope.memory()))
      outlines.add(side, slope);
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
