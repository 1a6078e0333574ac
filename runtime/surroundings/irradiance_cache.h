// What virtual things change in the light of real meshes, gathered by rays at few points of their
// surface and interpolated to all vertices: dense where a virtual thing is near, sparse elsewhere.
// threads: thread-bound, parallel inside
// source: Ward, Rubinstein & Clear 1988 (irradiance caching); Xu 2005, 9.2.1 (of visibility);
// differs: the points are chosen once, at several spacings, and only those in use are gathered at
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "prt/rays/ray_pattern.h"
#include "runtime/scene/scene.h"
#include "runtime/surroundings/occlusion_probes.h"
#include "runtime/surroundings/real_point.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::runtime {

/// A ray that virtual things may have changed: it meets one of them, or a plane near one.
struct GatherHit {
  static constexpr int kNone = -1;

  std::int16_t object = kNone;  // that it meets, and the vertex of it
  bool real = false;            // past all virtual things it meets something real, or else the sky
  std::uint32_t vertex = 0;
  RealPoint behind;
  glm::vec3 direction{0};  // unit, world
};

class IrradianceCache {
 public:
  /// Of each point, distributed by the cosine.
  static constexpr int kRays = 128;
  /// Points lie this fraction of the distance to the nearest virtual thing apart.
  static constexpr float kSpacing = .35f;
  /// Where what an object changes ends, in its radii; it fades over the last of them.
  static constexpr float kReach = 5;

  /// The scene must outlive it. Idle without real meshes or objects.
  explicit IrradianceCache(const PreparedScene& scene);

  /// Casts rays where something moved. `other_form`: of an object, where poses do not tell.
  /// in: occluders as made for this scene; probes: vertices spread over each object
  void update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
              const OcclusionProbes& around, bool other_form);

  std::size_t points() const { return used_.size(); }
  /// Of one point; each ray stands for 1/kRays of the irradiance over pi.
  std::span<const GatherHit> hits(std::size_t point) const { return hits_[point]; }
  /// in: a value for each of points(), as last looked at
  /// out: one for each vertex of the real mesh, 0 where nothing virtual is near
  void interpolate(std::span<const Rgb> of_points, std::span<Rgb> out) const;

 private:
  static constexpr std::size_t kNearest = 4;
  struct NearPoints {
    std::array<std::uint32_t, kNearest> point;
    std::array<float, kNearest> weight;  // sum 1
  };
  struct Level {
    float spacing_m;
    std::vector<std::uint32_t> points;  // vertices
    std::vector<NearPoints> nearby;     // by vertex
    std::vector<std::int32_t> used;     // by point: its place among the used ones, or kNone
  };
  // Between the two levels whose spacings are around what is wanted.
  struct Wanted {
    std::uint8_t level = 0;
    float finer = 0;  // weight of `level`; the rest is of the one after it
    float fade = 0;   // 0..1; 0 where nothing virtual is near
  };
  struct UsedPoint {
    std::size_t level, point;
  };
  struct Neighbour;
  Wanted wanted_at(std::size_t vertex, std::span<const Neighbour> neighbours) const;
  void mark_used();
  void gather(std::size_t point, const shadows::RayOccluders& occluders,
              std::span<const Neighbour> neighbours);

  const PreparedScene* scene_;
  prt::RayPatterns patterns_{kRays};
  std::vector<Level> levels_;  // from fine to coarse, each twice as far apart
  std::vector<Pose> poses_;
  std::vector<Wanted> wanted_;  // by vertex
  std::vector<UsedPoint> used_;
  std::vector<std::vector<GatherHit>> hits_;
};

}  // namespace penumbra::runtime
