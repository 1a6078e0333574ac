// What several real planes hide of the light from each other, and send instead.
// threads: reentrant
#pragma once

#include <array>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/sh.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"

namespace penumbra::runtime {

/// Planes are infinite: which of two is seen in a direction is the same from all over the part of
/// one that is in front of the other. So each has one change of its irradiance. Where three or more
/// meet, that at the place next to `middle` counts everywhere.
class PlaneExchange {
 public:
  static constexpr int kRays = 512;  // by the cosine, from each plane

  /// A plane of unknown albedo, which is zero, hides nothing: what it sends is not known, and the
  /// map may show it.
  PlaneExchange(std::span<const prt::Plane> planes, const glm::dvec3& middle);

  /// True where planes stand before each other.
  bool any() const { return any_; }
  /// What the residual on each plane changes by: the light of the planes that it sees less that of
  /// the sky behind them.
  /// in:  residuals, of each plane
  /// out: irradiance by plane
  /// source: radiosity by Jacobi iteration, Cohen & Wallace 1993, section 5.3
  void changes(std::span<const RadianceSh* const> residuals,
               std::span<const lighting::DistantLight> lights, std::span<Rgb> out) const;

 private:
  static constexpr int kBounces = 32;  // of a closed room of .8: a thousandth is left
  struct SeenByPlane {
    glm::vec3 from{0};                             // a place in front of all other planes
    std::array<float, kMaxCoefficients> hidden{};  // mean of the basis, 0 where no plane hides it
    std::vector<float> factors;  // of its view by the cosine, by plane that is seen
  };
  float lit_fraction(std::size_t plane, const lighting::DistantLight& light) const;

  std::span<const prt::Plane> planes_;
  std::vector<SeenByPlane> seen_;
  bool any_ = false;
};

}  // namespace penumbra::runtime
