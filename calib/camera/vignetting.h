// How much light a lens leaves towards the borders of its picture.
// threads: plain values
#pragma once

#include <array>
#include <glm/vec2.hpp>

#pragma GCC visibility push(default)
namespace penumbra {

/// V = 1 + a1 p^2 + a2 p^4 + a3 p^6 with the distance p from the centre in half diagonals of the
/// picture.
struct Vignetting {
  std::array<double, 3> terms{};
  glm::dvec2 centre_px{0, 0};
  double half_diagonal_px = 1;

  bool none() const { return terms == std::array<double, 3>{}; }
  /// Fraction of the light that is left at a continuous pixel.
  double at(const glm::dvec2& px) const {
    const glm::dvec2 off = (px - centre_px) / half_diagonal_px;
    return at_squared(off.x * off.x + off.y * off.y);
  }
  double at_squared(double p2) const {
    return 1 + p2 * (terms[0] + p2 * (terms[1] + p2 * terms[2]));
  }
};

}  // namespace penumbra
#pragma GCC visibility pop
