// How much of a disc the outlines over a place leave in sight.
#pragma once

#include <cstdint>
#include <span>

#include "shadows/visibility/internal/outline_grid.h"
#include "shadows/visibility/internal/part_kernel.h"

namespace penumbra::shadows {

/// Directions of a disc.
struct Taps {
  std::span<const glm::vec3> directions;  // world frame, at most kMostTaps
  std::uint64_t counted =
      ~std::uint64_t{0};  // bit by tap: whether its light counts where it is seen
};

/// Counts, from the disc's middle to each of its taps, the layers of surface that begin or end on the way: outlines that
/// cross it. One ray to the tap with the fewest layers then tells of all.
/// source: Laine, Aila, Assarsson, Lehtinen & Akenine-Moller 2005, "Soft Shadow Volumes for Ray Tracing"
/// threads: thread-bound
class PartSeen {
 public:
  /// The outlines and what throws them outlive it.
  PartSeen(const OutlineGrid& outlines, const LightGrid& grid, std::span<const Thrower> throwers,
           const Taps& taps);

  /// Means over the taps of the cosine: of all of the disc, and of what is seen if tap `ask` is. Else nothing is.
  struct Answer {
    float open = 0, seen = 0;
    std::uint32_t ask = 0;
  };
  /// in: a place in the grid where it has lists; how far above it rays start; the surface's normal in the world frame
  Answer find(const glm::vec3& place, const glm::vec3& lift, const glm::vec3& normal);

 private:
  void add(const Line& line, const glm::vec3& place);

  const OutlineGrid& outlines_;
  std::span<const Thrower> throwers_;
  PartTaps taps_;        // ways from the middle, and layers more than there
  glm::vec2 middle_{0};  // a little off the disc's, cells for each metre towards the light
  float reach_ = 0;      // of the taps
};

}  // namespace penumbra::shadows
