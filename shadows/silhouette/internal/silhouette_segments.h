// Silhouettes of meshes against directions of light, as they lie on a plane.
#pragma once

#include <memory_resource>
#include <span>
#include <vector>

#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/silhouette_cache.h"

namespace penumbra::shadows {

/// A direction of light over the plane.
struct PlaneSample {
  glm::dvec2 shift{0};  // of a shadow, for each metre of height; x and z of the plane frame
  float weight = 0;     // of all light on the open plane
};

/// Directions, and what is around all of them.
struct SampleCone {
  std::span<const PlaneSample> samples;  // at most kMaxDirections
  DirectionCone around;
};

/// Nodes cell_m apart, (i, j) at (i, 0, j) * cell_m.
struct NodeGrid {
  Pose world_from_map;  // y the plane's normal
  float cell_m = 0;
  float width = 0, depth = 0;  // nodes
};

/// A stretch of a silhouette: where it is passed upwards in z, so many layers more lie on its far
/// side in x for the directions of `more`, and fewer for those of `fewer`.
struct SilhouetteSegment {
  glm::vec3 from, to;  // x and z in cells, y in metres above near_m
  std::uint64_t more, fewer;
  std::int16_t layers;
};

/// Every triangle counts one layer in what it covers; between two that face the light alike the
/// edge cancels. What is lower than near_m above the plane is cut off. Left out are stretches that
/// the samples cast above, below or to the right of the grid, where they make no difference.
std::pmr::vector<SilhouetteSegment> find_sides(std::span<const Caster> casters,
                                               const NodeGrid& grid, float near_m,
                                               const SampleCone& light, SilhouetteCache& cache,
                                               std::pmr::memory_resource* memory);

}  // namespace penumbra::shadows
