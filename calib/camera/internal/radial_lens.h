// Private to calib: the projections whose picture radius depends on the angle from one axis only.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "calib/camera/camera_model.h"
#include "core/conventions.h"

namespace penumbra::calib {

/// Picture radius rho over the angle theta from the axis, for a focal length of 1.
class RadialCurve {
 public:
  enum class CurveKind { kEquidistant, kMirrorBall, kKannalaBrandt, kDoubleSphere };
  RadialCurve(CurveKind kind, const std::array<double, 5>& k)
      : kind_(kind), k_(k), last_(last_angle()) {
    rim_ = rho(last_);
  }

  [[nodiscard]] double rho(double theta) const {
    switch (kind_) {
      case CurveKind::kMirrorBall:
        return std::sin(theta / 2);
      case CurveKind::kKannalaBrandt: {
        const double t = theta * theta;
        return theta * (1 + t * (k_[0] + t * (k_[1] + t * (k_[2] + t * k_[3]))));
      }
      case CurveKind::kDoubleSphere: {
        const double z = k_[0] + std::cos(theta), s = std::sin(theta);
        return s / (k_[1] * std::hypot(s, z) + (1 - k_[1]) * z);
      }
      default:
        return theta;
    }
  }

  /// Inverse on 0..rim().
  [[nodiscard]] double theta(double rho) const {
    switch (kind_) {
      case CurveKind::kMirrorBall:
        return 2 * std::asin(std::min(rho, 1.));
      case CurveKind::kKannalaBrandt:
        return newton(rho);
      case CurveKind::kDoubleSphere:
        return unproject_double_sphere(rho);
      default:
        return rho;
    }
  }

  [[nodiscard]] double rim() const { return rim_; }          // rho of the last angle
  [[nodiscard]] double last_theta() const { return last_; }  // pi where the whole sphere is seen
  [[nodiscard]] bool is_mirror() const { return kind_ == CurveKind::kMirrorBall; }
  [[nodiscard]] bool is_equidistant() const { return kind_ == CurveKind::kEquidistant; }

 private:
  [[nodiscard]] double slope(double theta) const {  // of rho, Kannala-Brandt
    const double t = theta * theta;
    return 1 + t * (3 * k_[0] + t * (5 * k_[1] + t * (7 * k_[2] + t * 9 * k_[3])));
  }

  // Where the picture would fold back on itself, at most pi.
  [[nodiscard]] double last_angle() const {
    if (kind_ == CurveKind::kKannalaBrandt) {
      constexpr int kSteps = 90;
      for (int i = 1; i <= kSteps; ++i)
        if (slope(kPi * i / kSteps) <= 0) return kPi * (i - 1) / kSteps;
      return kPi;
    }
    if (kind_ != CurveKind::kDoubleSphere) return kPi;
    // Usenko et al. 2018, eq. 43-45; a little inside, where rho is still finite.
    const double xi = k_[0], alpha = k_[1];
    const double w1 = alpha <= .5 ? alpha / (1 - alpha) : (1 - alpha) / alpha;
    const double w2 = (w1 + xi) / std::sqrt(2 * w1 * xi + xi * xi + 1);
    constexpr double kInside = 1e-3;
    return std::acos(std::clamp(-w2, -1., 1.)) - kInside;
  }

  [[nodiscard]] double newton(double rho) const {
    double low = 0, high = last_, theta = std::min(rho, last_);
    for (int i = 0; i < 50; ++i) {
      const double off = this->rho(theta) - rho;
      (off > 0 ? high : low) = theta;
      double next = theta - off / slope(theta);
      if (std::abs(next - theta) < 1e-12) return next;  // its own error is the square of that
      if (!(next > low && next < high)) next = (low + high) / 2;
      theta = next;
    }
    return theta;
  }

  // Usenko et al. 2018, eq. 46-49.
  [[nodiscard]] double unproject_double_sphere(double rho) const {
    const double xi = k_[0], alpha = k_[1], r2 = rho * rho;
    const double root = std::sqrt(std::max(0., 1 - (2 * alpha - 1) * r2));
    const double mz = (1 - alpha * alpha * r2) / (alpha * root + 1 - alpha);
    const double scale =
        (mz * xi + std::sqrt(std::max(0., mz * mz + (1 - xi * xi) * r2))) / (mz * mz + r2);
    return std::atan2(scale * rho, scale * mz - xi);
  }

  CurveKind kind_;
  std::array<double, 5> k_;
  double last_, rim_ = 0;
};

/// Normalised picture coordinates q = (pixel - centre) / focal and their radius rho = |q|. Theta is
/// counted from -z; of the mirror ball from +z: the ray of an orthographic camera leaves the sphere
/// at twice the angle of the normal, whose sine is rho (focal = radius of the ball). Angular:
/// equidistant with focal = R/pi.
struct RadialLens {
  glm::dvec2 centre_px{0, 0};
  glm::dvec2 focal_px{1, 1};
  RadialCurve curve;

  [[nodiscard]] double rim() const { return curve.rim(); }

  /// Unit direction at normalised coordinates within the rim; y down in q.
  [[nodiscard]] glm::dvec3 direction(const glm::dvec2& q) const {
    const double rho = std::fmin(std::hypot(q.x, q.y), rim());
    const bool mirror = curve.is_mirror();
    if (rho == 0) return {0, 0, mirror ? 1 : -1};
    const double theta = mirror ? 0 : curve.theta(rho);
    // Mirror ball without inverse functions, which lose digits towards the rim:
    // sin th = 2 sin(th/2) cos(th/2), cos th = 1 - 2 sin^2(th/2).
    const double sine = mirror ? 2 * rho * std::sqrt(1 - rho * rho) : std::sin(theta);
    const double cosine = mirror ? 1 - 2 * rho * rho : std::cos(theta);
    const double k = sine / std::hypot(q.x, q.y);
    return {q.x * k, -q.y * k, mirror ? cosine : -cosine};
  }

  /// Normalised coordinates of a unit direction; nothing beyond the last angle. The far pole, which
  /// is the whole rim, goes to +x.
  [[nodiscard]] std::optional<glm::dvec2> coordinates(const glm::dvec3& d) const {
    const double side = std::hypot(d.x, d.y);
    const double theta = std::atan2(side, curve.is_mirror() ? d.z : -d.z);
    if (theta > curve.last_theta()) return std::nullopt;
    const double rho = curve.rho(theta);
    if (side == 0) return glm::dvec2{rho, 0};
    return glm::dvec2{d.x / side * rho, -d.y / side * rho};
  }

  /// 1 - cos theta at the rim and beyond.
  [[nodiscard]] double flux_outside() const { return 1 - std::cos(curve.last_theta()); }

  /// (1 - cos theta) / rho^2, finite at the centre; the primitive of the solid angle, see
  /// projection_table.cpp.
  [[nodiscard]] double flux_density(double rho2) const {
    if (curve.is_mirror()) return 2;  // 1 - cos th = 2 sin^2(th/2) = 2 rho^2
    const double rho = std::sqrt(rho2), half = curve.theta(rho) / 2;
    if (curve.is_equidistant() || rho < 1e-6) {
      const double sinc = half < 1e-6 ? 1 : std::sin(half) / half;
      const double stretch = rho < 1e-6 ? 1 / slope_at_centre() : 1;
      return stretch * stretch * sinc * sinc / 2;
    }
    const double s = std::sin(half) / rho;
    return 2 * s * s;
  }

 private:
  // rho over theta.
  [[nodiscard]] double slope_at_centre() const { return curve.rho(1e-6) / 1e-6; }
};

/// Nothing for the other kinds.
inline std::optional<RadialLens> radial_lens(const CameraModel& p) {
  using CurveKind = RadialCurve::CurveKind;
  const glm::dvec2 middle{p.width / 2., p.height / 2.};
  const double radius = std::fmin(middle.x, middle.y);
  switch (p.kind) {
    case ProjectionKind::kAngular:
      return RadialLens{middle, glm::dvec2(radius / kPi), {CurveKind::kEquidistant, {}}};
    case ProjectionKind::kMirrorBall:
      return RadialLens{middle, glm::dvec2(radius), {CurveKind::kMirrorBall, {}}};
    case ProjectionKind::kEquidistant:
      return RadialLens{p.principal_px, p.focal_px, {CurveKind::kEquidistant, {}}};
    case ProjectionKind::kKannalaBrandt:
      return RadialLens{p.principal_px, p.focal_px, {CurveKind::kKannalaBrandt, p.distortion}};
    case ProjectionKind::kDoubleSphere:
      return RadialLens{p.principal_px, p.focal_px, {CurveKind::kDoubleSphere, p.distortion}};
    default:
      return std::nullopt;
  }
}

}  // namespace penumbra::calib
