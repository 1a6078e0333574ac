// What several real planes hide of the light from each other, and send instead.
// threads: reentrant
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"

namespace penumbra::runtime {

/// Planes are infinite: which of two is seen in a direction is the same from all over a plane. So
/// each has one change of its irradiance. Where three or more meet, that at the place next to
/// `middle` counts everywhere.
class PlaneExchange {
 public:
  static constexpr int kRays = 512;  // by the cosine, from each plane

  PlaneExchange(std::span<const prt::Plane> planes, const glm::dvec3& middle);

  /// True where planes stand before each other.
  bool any() const { return !hidden_.empty(); }
  /// What the residual on each open plane changes by: the light of the planes that it sees less
  /// that of the sky behind them.
  /// in:  residuals, of each plane
  /// out: irradiance by plane
  /// source: radiosity by Jacobi iteration, Cohen & Wallace 1993, section 5.3
  void changes(std::span<const RadianceSh* const> residuals,
               std::span<const lighting::DistantLight> lights, std::span<Rgb> out) const;

 private:
  static constexpr int kBounces = 6;
  static constexpr float kOfRay = static_cast<float>(1. / kRays);
  struct HiddenRay {
    std::uint16_t from, to;  // planes
    glm::vec3 direction;
  };
  bool is_lit(std::size_t plane, const glm::dvec3& towards) const;

  std::span<const prt::Plane> planes_;
  std::vector<glm::vec3> feet_;  // of the middle
  std::vector<HiddenRay> hidden_;
};

}  // namespace penumbra::runtime
