// How much of a light the silhouettes over a place leave visible.
#pragma once

#include <cstdint>
#include <span>

#include "shadows/visibility/internal/silhouette_grid.h"
#include "shadows/visibility/internal/soft_shadow_kernel.h"

namespace penumbra::shadows {

/// Directions of a light.
struct SampleSet {
  std::span<const glm::vec3> directions;  // world frame, at most kMaxSamples
  // Bit by sample: whether its light counts where it is seen
  std::uint64_t counted = ~std::uint64_t{0};
};

/// Counts, from the light's middle to each of its samples, the layers of surface that begin or end
/// on the way: silhouettes that cross it. One ray to the sample with the fewest layers then tells
/// of all.
/// source: Laine, Aila, Assarsson, Lehtinen & Akenine-Moller 2005, "Soft Shadow Volumes for Ray
/// Tracing"
/// threads: thread-bound
class SoftShadowVolume {
 public:
  /// The silhouettes and what casts them outlive it.
  SoftShadowVolume(const SilhouetteGrid& silhouettes, const LightGrid& grid,
                   std::span<const CasterFrame> caster_frames, const SampleSet& samples);

  /// Means over the samples of the cosine: of all of the light, and of what is seen if sample `ask`
  /// is. Else nothing is.
  struct Answer {
    float open = 0, seen = 0;
    std::uint32_t ask = 0;
  };
  /// in: a place in the grid where it has lists; how far above it rays start; the surface's normal
  /// in the world frame
  Answer find(const glm::vec3& place, const glm::vec3& lift, const glm::vec3& normal);

 private:
  void add(const SilhouetteLine& line, const glm::vec3& place);

  const SilhouetteGrid& silhouettes_;
  std::span<const CasterFrame> caster_frames_;
  LayerSamples samples_;  // ways from the middle, and layers more than there
  glm::vec2 middle_{0};   // a little off the light's, cells for each metre towards the light
  float reach_ = 0;       // of the samples
};

}  // namespace penumbra::shadows
