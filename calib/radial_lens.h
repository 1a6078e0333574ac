// Private to calib: the three projections whose picture radius depends on the angle from one axis
// only.
#pragma once

#include <cmath>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "calib/calib.h"
#include "core/conventions.h"

namespace penumbra::calib {

/// Normalised picture coordinates q = (pixel - centre) / focal and their radius rho = |q|.
/// Equidistant and angular: theta = rho, counted from -z (angular: focal = R/pi, so that theta = pi
/// on the inscribed circle). Mirror ball: rho = sin(theta/2), theta counted from +z, focal = R: the
/// ray of an orthographic camera leaves the sphere at twice the angle of the normal, whose sine is
/// rho.
struct RadialLens {
  glm::dvec2 centre_px{0, 0};
  glm::dvec2 focal_px{1, 1};
  double rim = 1;       // rho of theta = pi, the end of the sphere
  bool mirror = false;  // mirror ball

  /// Unit direction at normalised coordinates within the rim; y down in q.
  glm::dvec3 direction(const glm::dvec2& q) const {
    const double rho = std::fmin(std::hypot(q.x, q.y), rim);
    if (rho == 0) return {0, 0, mirror ? 1 : -1};
    // Mirror ball without inverse functions, which lose digits towards the rim:
    // sin th = 2 sin(th/2) cos(th/2), cos th = 1 - 2 sin^2(th/2).
    const double sine = mirror ? 2 * rho * std::sqrt(1 - rho * rho) : std::sin(rho);
    const double cosine = mirror ? 1 - 2 * rho * rho : std::cos(rho);
    const double k = sine / std::hypot(q.x, q.y);
    return {q.x * k, -q.y * k, mirror ? cosine : -cosine};
  }

  /// Normalised coordinates of a unit direction. The far pole, which is the whole rim, goes to +x.
  glm::dvec2 coordinates(const glm::dvec3& d) const {
    const double side = std::hypot(d.x, d.y);
    const double theta = std::atan2(side, mirror ? d.z : -d.z);
    const double rho = mirror ? std::sin(theta / 2) : theta;
    if (side == 0) return {rho, 0};
    return {d.x / side * rho, -d.y / side * rho};
  }

  /// (1 - cos theta) / rho^2, finite at the centre; the primitive of the solid angle, see
  /// projection_table.cpp.
  double flux_density(double rho2) const {
    if (mirror) return 2;  // 1 - cos th = 2 sin^2(th/2) = 2 rho^2
    const double half = std::sqrt(rho2) / 2;
    const double sinc = half < 1e-6 ? 1 : std::sin(half) / half;
    return sinc * sinc / 2;
  }
};

/// Nothing for the other kinds.
inline std::optional<RadialLens> radial_lens(const Projection& p) {
  const glm::dvec2 middle{p.width / 2., p.height / 2.};
  const double radius = std::fmin(middle.x, middle.y);
  switch (p.kind) {
    case ProjectionKind::kAngular:
      return RadialLens{middle, glm::dvec2(radius / kPi), kPi, false};
    case ProjectionKind::kMirrorBall:
      return RadialLens{middle, glm::dvec2(radius), 1, true};
    case ProjectionKind::kEquidistant:
      return RadialLens{p.principal_px, p.focal_px, kPi, false};
    default:
      return std::nullopt;
  }
}

}  // namespace penumbra::calib
