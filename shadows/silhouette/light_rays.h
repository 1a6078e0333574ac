// Directions over a light, and rays in packets: what every way of tracing a light shares.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"
#include "prt/rays/rays.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/silhouette_cache.h"
#include "shadows/silhouette/silhouette_mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

inline constexpr int kMaxSamples = 64;

/// Radians from the light's middle, to its farthest direction and in the mean of all.
double largest_angle(const lighting::DistantLight& source);
double rms_angle(const lighting::DistantLight& source);

/// Whether a light's penumbras on an object, of parts as far as its radius, are wider than a few
/// edges, so that neighbours may share the light of their rays.
bool penumbra_exceeds_edges(const lighting::DistantLight& source, const SilhouetteMesh& silhouette);

/// All of a light's directions, and those so many radians off it.
DirectionCone cone_of(const lighting::DistantLight& source, double more = 0);

BoundingSphere sphere_of(const Caster& caster);
/// Whether both are one thing in one place.
inline bool is_same(const Caster& a, const Caster& b) {
  return a.silhouette == b.silhouette && a.world_from_mesh == b.world_from_mesh;
}

/// The cache that casters bring, or an empty one.
SilhouetteCache& cache_of(const ShadowCasters& casters);

inline constexpr int kTurns = 64;  // copies for vertices

/// An object on a plane gets nothing from behind it but what the bake knows.
inline bool behind(const prt::Plane* plane, const glm::vec3& d) {
  return plane && glm::dot(glm::vec3(plane->normal), d) <= 0;
}

/// Directions over a light in `turns` copies, each turned about its axis by another angle; of a
/// form each takes other points, as long as there are more points than samples. A single sample in
/// a single turn is the light's middle.
/// threads: thread-bound; memory grows once
class SamplePattern {
 public:
  /// in: samples 1..kMaxSamples
  void make(const lighting::DistantLight& source, int samples, int turns);
  /// Directions behind the plane give their place to others, of their turn if it has any. Nothing
  /// changes where all are.
  void keep_before(const prt::Plane& plane);
  std::span<const glm::vec3> at(std::size_t point) const {
    const auto samples = static_cast<std::size_t>(samples_);
    return {&directions_[point % static_cast<std::size_t>(turns_) * samples], samples};
  }
  /// How many different ones of a point's directions lie before its surface.
  int count_before(std::size_t point, const glm::vec3& normal) const;

 private:
  void spread_over_cap(const lighting::DistantLight& source);
  void spread_over_shape(const lighting::DistantLight& source);

  int samples_ = 0, turns_ = 1;
  std::vector<char> repeated_;  // by direction, whether its turn has it already; empty: none
  std::vector<glm::vec3> directions_;
};

/// Gathers rays into packets of sixteen and hands each full packet's answers back.
template <class Answer>
class Packets {
 public:
  Packets(const RayOccluders& occluders, Answer answer) : occluders_(occluders), answer_(answer) {}
  ~Packets() { flush(); }
  Packets(const Packets&) = delete;
  Packets& operator=(const Packets&) = delete;

  void add(std::size_t point, float weight, const glm::vec3& o, const glm::vec3& d,
           float far = 1e30f) {
    rays_.far[count_] = far;
    rays_.ox[count_] = o.x, rays_.oy[count_] = o.y, rays_.oz[count_] = o.z;
    rays_.dx[count_] = d.x, rays_.dy[count_] = d.y, rays_.dz[count_] = d.z;
    point_[count_] = point;
    weight_[count_] = weight;
    if (++count_ == prt::RayWorld::kPacket) flush();
  }

 private:
  void flush() {
    if (count_ == 0) return;
    const auto blocked = [&](const prt::RayWorld* world) {
      return world && !world->empty() ? world->occluded(rays_, count_) : 0u;
    };
    const std::uint32_t by_virtual = blocked(occluders_.virtual_things),
                        by_real =
                            blocked(occluders_.real_things) | blocked(occluders_.passing_things);
    for (int i = 0; i < count_; ++i)
      answer_(point_[i], weight_[i], (by_virtual >> i & 1) != 0, (by_real >> i & 1) != 0);
    count_ = 0;
  }

  const RayOccluders& occluders_;
  Answer answer_;
  prt::RayWorld::Rays rays_;
  std::size_t point_[prt::RayWorld::kPacket];
  float weight_[prt::RayWorld::kPacket];
  int count_ = 0;
};

}  // namespace penumbra::shadows
#pragma GCC visibility pop
