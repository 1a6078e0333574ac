// The edges that can be an outline against a light, found once for all who ask.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/pose.h"
#include "shadows/outline.h"

namespace penumbra::shadows {

/// Directions around one.
struct Beam {
  glm::dvec3 towards;  // unit
  double sine;         // of the largest angle from it; 1: any direction of the sphere
};

/// For one light and one form of every mesh: what it lights and every plane on which it throws shadows ask for the same
/// edges. Clear it when a light or a form changes.
/// threads: thread-bound; memory grows to that of the largest light
class OutlineMemo {
 public:
  void clear() { used_ = 0; }
  /// The places in outline.edges(), in their order, of all edges that are an outline for some direction of the beam, and of
  /// open ones. Others may be among them. Valid until clear().
  std::span<const std::uint32_t> edges(const Outline& outline, const Pose& world_from_mesh,
                                       const Beam& beam);

 private:
  struct Known {
    const Outline* outline;
    glm::vec3 towards;  // mesh frame
    float sine;
    std::vector<std::uint32_t> edges;
  };
  std::vector<Known> known_;
  std::size_t used_ = 0;
  std::vector<std::uint8_t> faces_;
};

}  // namespace penumbra::shadows
