#include "tools/chart/peers/visibility_cache.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>

#include "shadows/silhouette/light_rays.h"
#include "shadows/silhouette/place_kernel.h"

namespace penumbra::tools {

namespace {

constexpr float kMaxDistance = .5f;  // of the object's radius: no vertex speaks for more
constexpr float kMinError = 1e-3f;   // of a sample that is the vertex itself

// Rays from one place, sixteen at a time.
class FromVertex {
 public:
  FromVertex(const prt::Mesh& mesh, std::size_t vertex, float near_m)
      : normal_(mesh.normals[vertex]), origin_(mesh.positions[vertex] + near_m * normal_) {}

  const glm::vec3& normal() const { return normal_; }
  bool full() const { return count_ == prt::RayWorld::kPacket; }
  int count() const { return count_; }
  void clear() { count_ = 0; }
  void add(const glm::vec3& d) {
    rays_.ox[count_] = origin_.x, rays_.oy[count_] = origin_.y, rays_.oz[count_] = origin_.z;
    rays_.dx[count_] = d.x, rays_.dy[count_] = d.y, rays_.dz[count_] = d.z;
    ++count_;
  }
  const prt::RayWorld::Rays& rays() const { return rays_; }

 private:
  glm::vec3 normal_, origin_;
  prt::RayWorld::Rays rays_;
  int count_ = 0;
};

// In the mesh's order with gaps that are halved each time, so that rays that follow each other
// start near each other.
std::vector<std::uint32_t> coarse_first(std::size_t count) {
  constexpr std::uint32_t kFirstGap = 64;
  std::vector<std::uint32_t> out;
  for (std::uint32_t i = 0; i < count; i += kFirstGap) out.push_back(i);
  for (std::uint32_t gap = kFirstGap; gap > 1; gap /= 2)
    for (std::uint32_t i = gap / 2; i < count; i += gap) out.push_back(i);
  return out;
}

// What other cells have in the slot only costs time: each sample is asked for its own error.
std::size_t slot_of(int level, const glm::ivec3& cell, std::size_t slots) {
  const auto hash = static_cast<std::uint32_t>(cell.x) * 73856093u ^
                    static_cast<std::uint32_t>(cell.y) * 19349663u ^
                    static_cast<std::uint32_t>(cell.z) * 83492791u ^
                    static_cast<std::uint32_t>(level) * 2654435761u;
  return (hash ^ hash >> 15) & (slots - 1);
}

}  // namespace

Result<VisibilityCache> VisibilityCache::create(const prt::Mesh& mesh, float near_m) {
  PENUMBRA_ASSIGN(world, prt::RayWorld::create());
  PENUMBRA_TRY(world.add(mesh));
  return VisibilityCache(mesh, std::move(world), near_m);
}

VisibilityCache::VisibilityCache(const prt::Mesh& mesh, prt::RayWorld world, float near_m)
    : mesh_(&mesh),
      world_(std::move(world)),
      near_m_(near_m),
      radius_m_(prt::radius_around(mesh, prt::bounds_of(mesh).centre())),
      low_(prt::bounds_of(mesh).low),
      order_(coarse_first(mesh.positions.size())),
      heads_(kSlots, -1) {
  for (std::size_t i = 0; i < mesh.positions.size(); ++i)
    distance_m_.push_back(occluder_distance_m(i));
}

// Harmonic mean over what sixteen rays of the hemisphere meet.
float VisibilityCache::occluder_distance_m(std::size_t vertex) const {
  constexpr float kGoldenAngle = 2.399963f;
  constexpr int kRays = prt::RayWorld::kPacket;
  FromVertex from(*mesh_, vertex, near_m_);
  const glm::vec3 &n = from.normal(),
                  side = std::abs(n.y) < .9f ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0),
                  u = glm::normalize(glm::cross(side, n)), v = glm::cross(n, u);
  const float turn = kGoldenAngle * static_cast<float>(vertex % 64);
  for (int k = 0; k < kRays; ++k) {
    const float r = std::sqrt((static_cast<float>(k) + .5f) / kRays),
                angle = kGoldenAngle * static_cast<float>(k) + turn;
    from.add(r * std::cos(angle) * u + r * std::sin(angle) * v + std::sqrt(1 - r * r) * n);
  }
  prt::RayWorld::Hits hits;
  world_.intersect(0, from.rays(), hits);
  float nearness = 0, hidden = 0;
  for (int k = 0; k < kRays; ++k)
    if (hits.mesh[k] >= 0) nearness += 1 / std::max(hits.distance[k], near_m_), ++hidden;
  const float max = kMaxDistance * radius_m_;
  return hidden > 0 ? std::min(max, hidden / nearness) : max;
}

// The visible part of the light, by its cosines; nothing where all directions are behind.
std::optional<float> VisibilityCache::trace(std::size_t vertex,
                                            std::span<const glm::vec3> directions) const {
  FromVertex from(*mesh_, vertex, near_m_);
  float visible = 0, all = 0;
  std::array<float, prt::RayWorld::kPacket> cosines{};
  const auto ask = [&] {
    const std::uint32_t hidden = world_.occluded(from.rays(), from.count());
    for (std::size_t k = 0; k < static_cast<std::size_t>(from.count()); ++k)
      if (!(hidden >> k & 1u)) visible += cosines[k];
    from.clear();
  };
  for (const glm::vec3& d : directions) {
    const float cosine = glm::dot(from.normal(), d);
    if (cosine <= 0) continue;
    all += cosine;
    cosines[static_cast<std::size_t>(from.count())] = cosine;
    from.add(d);
    if (from.full()) ask();
  }
  if (from.count() > 0) ask();
  if (!(all > 0)) return {};
  return visible / all;
}

void VisibilityCache::clear() {
  std::ranges::fill(heads_, -1);
  entries_.clear(), samples_.clear();
  used_levels_ = 0;
}

float VisibilityCache::cell_m(int level) const {
  return 2 * radius_m_ / static_cast<float>(1 << level);
}

glm::ivec3 VisibilityCache::cell_of(const glm::vec3& p, int level) const {
  return glm::ivec3(glm::floor((p - low_) / cell_m(level)));
}

// Into all cells that its sphere meets, at the level whose cells are at least as wide as it.
void VisibilityCache::insert(std::size_t vertex, float visible, float max_error) {
  const glm::vec3& position = mesh_->positions[vertex];
  const float reach = max_error * distance_m_[vertex];
  int level = 0;
  while (level + 1 < kLevels && cell_m(level + 1) >= 2 * reach) ++level;
  used_levels_ |= 1u << level;
  const auto index = static_cast<std::uint32_t>(samples_.size());
  samples_.push_back({position, mesh_->normals[vertex], 1 / distance_m_[vertex], visible});
  const glm::ivec3 from = cell_of(position - reach, level), to = cell_of(position + reach, level);
  for (int z = from.z; z <= to.z; ++z)
    for (int y = from.y; y <= to.y; ++y)
      for (int x = from.x; x <= to.x; ++x) {
        std::int32_t& head = heads_[slot_of(level, {x, y, z}, kSlots)];
        entries_.push_back({index, head});
        head = static_cast<std::int32_t>(entries_.size()) - 1;
      }
}

bool VisibilityCache::interpolate(std::size_t vertex, float max_error, float& visible) const {
  const glm::vec3 &position = mesh_->positions[vertex], &normal = mesh_->normals[vertex];
  float sum = 0, weights = 0;
  for (int level = 0; level < kLevels; ++level) {
    if (!(used_levels_ >> level & 1u)) continue;
    for (auto e = heads_[slot_of(level, cell_of(position, level), kSlots)]; e >= 0;
         e = entries_[static_cast<std::size_t>(e)].next) {
      const Sample& s = samples_[entries_[static_cast<std::size_t>(e)].sample];
      const float error = glm::distance(position, s.position) * s.per_distance +
                          std::sqrt(std::max(0.f, 1 - glm::dot(normal, s.normal)));
      if (error > max_error) continue;
      const float weight = 1 / std::max(error, kMinError);
      sum += weight * s.visible, weights += weight;
    }
  }
  if (weights > 0) visible = sum / weights;
  return weights > 0;
}

std::size_t VisibilityCache::light(const lighting::DistantLight& source, int samples,
                                   float max_error, std::span<float> out) {
  clear();
  shadows::SamplePattern pattern, whole;
  pattern.make(source, samples, shadows::kTurns);
  const glm::vec3 towards(source.direction);
  const auto turned_away = -static_cast<float>(std::sin(shadows::largest_angle(source)));
  std::vector<float> visible(out.size());
  std::size_t traced = 0;
  for (const std::uint32_t i : order_) {
    if (glm::dot(mesh_->normals[i], towards) <= turned_away) continue;
    if (max_error > 0 && interpolate(i, max_error, visible[i])) continue;
    ++traced;
    const std::optional<float> seen = trace(i, pattern.at(i));
    if (!seen) continue;
    visible[i] = *seen;
    if (max_error > 0) insert(i, *seen, max_error);
  }
  whole.make(source, 16, 1);
  shadows::DirectionSet all{whole.at(0), towards, glm::vec3(0), 0};
  for (const glm::vec3& d : all.directions) {
    all.mean += d / static_cast<float>(all.directions.size());
    all.reach = std::max(all.reach, glm::distance(d, towards));
  }
  shadows::mean_cosines(mesh_->normals, all, out);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] *= visible[i];
  return traced;
}

}  // namespace penumbra::tools
