// The edges that can be a silhouette against a light, found once for all who ask.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/pose.h"
#include "shadows/silhouette/projection_kernel.h"
#include "shadows/silhouette/silhouette_mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

/// Directions around one.
struct DirectionCone {
  glm::dvec3 towards;  // unit
  double sine;         // of the largest angle from it; 1: any direction of the sphere
};

/// For one light and one form of every mesh: all planes on which it casts shadows ask for the same
/// edges. Clear it when a light or a form changes.
/// threads: thread-bound; memory grows to that of the largest light
class SilhouetteCache {
 public:
  void clear() { used_ = 0; }
  /// The places in SilhouetteMesh::edges(), in their order, of all edges that are a silhouette for
  /// some direction, and of open ones. Others may be among them. Valid until the cache is cleared.
  std::span<const std::uint32_t> find(const SilhouetteMesh& silhouette, const Pose& world_from_mesh,
                                      const DirectionCone& cone);

 private:
  struct KnownSilhouette {
    const SilhouetteMesh* silhouette;
    glm::vec3 towards;  // mesh frame
    float sine;
    std::vector<std::uint32_t> edges;
  };
  std::vector<KnownSilhouette> known_;
  // Scratch
  std::vector<std::uint32_t> unlike_;  // patches
  std::vector<std::uint8_t> faces_;    // by triangle: kFacesNone, kFacesAll or kUnsure
  std::size_t used_ = 0;
};

}  // namespace penumbra::shadows
#pragma GCC visibility pop
