// How much of a disc the outlines over a place leave in sight.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "shadows/disc_rays.h"
#include "shadows/outline_grid.h"

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
  /// All that is given outlives it.
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
  std::uint32_t nearest_alike(float layers, const glm::vec2& at) const;

  const OutlineGrid& outlines_;
  std::span<const Thrower> throwers_;
  const Taps& taps_;
  // Where rays go, cells for each metre towards the light.
  glm::vec2 middle_{0};  // a little off the disc's
  float reach_ = 0;      // of the taps
  // By tap: from the middle, and layers more than there.
  alignas(64) std::array<float, kMostTaps> x_{}, z_{}, layers_{};
  alignas(64) std::array<float, kMostTaps> towards_x_{}, towards_y_{}, towards_z_{}, cosine_{};
};

}  // namespace penumbra::shadows
