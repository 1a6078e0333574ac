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

/// What a mesh shows of itself to a cone of directions. Valid until the cache is cleared.
struct ConeSilhouette {
  /// The places in SilhouetteMesh::edges(), in their order, of all edges that are a silhouette for
  /// some direction, and of open ones. Others may be among them.
  std::span<const std::uint32_t> edges;
  /// By triangle: kFacesNone of the directions, kFacesAll, or kUnsure.
  std::span<const std::uint8_t> faces;
};

/// For one light and one form of every mesh: all planes on which it casts shadows ask for the same
/// edges. Clear it when a light or a form changes.
/// threads: thread-bound; memory grows to that of the largest light
class SilhouetteCache {
 public:
  void clear() { used_ = 0; }
  ConeSilhouette find(const SilhouetteMesh& silhouette, const Pose& world_from_mesh,
                      const DirectionCone& cone);

 private:
  struct KnownSilhouette {
    const SilhouetteMesh* silhouette;
    glm::vec3 towards;  // mesh frame
    float sine;
    std::vector<std::uint32_t> edges;
    std::vector<std::uint8_t> faces;
  };
  std::vector<KnownSilhouette> known_;
  std::vector<std::uint32_t> unlike_;  // patches
  std::size_t used_ = 0;
};

}  // namespace penumbra::shadows
#pragma GCC visibility pop
