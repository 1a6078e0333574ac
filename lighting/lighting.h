// Spherical-harmonic light: projection of environments, rotation, irradiance, the light estimate.
// Conventions (basis, sign, index, units) stand in core/conventions.h alone.
// threads: free functions reentrant; LatLongProjector thread-bound
#pragma once

#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <span>
#include <vector>

#include "core/environment.h"
#include "core/image.h"
#include "core/result.h"
#include "core/sh.h"
#include "core/units.h"

namespace penumbra::lighting {

// ---------------------------------------------------------------------------------- basis

/// Y_n(d) for n < bands^2; `direction` must be a unit vector, out must hold bands^2 values.
/// source: fully normalised associated Legendre recursion (Holmes & Featherstone 2002, eq. 11-13)
void evaluate_basis(int bands, const glm::dvec3& direction, std::span<double> out);

/// Sixteen directions at once in float: out[n * 16 + lane]. For bakes.
inline constexpr int kBasisLanes = 16;
void evaluate_basis_block(int bands, const float* x, const float* y, const float* z, float* out);

/// Radiance L(d) = sum l_n Y_n(d); negative lobes are kept.
Rgb evaluate(const RadianceSh& light, const glm::dvec3& direction);

// ---------------------------------------------------------------------------------- rotation

/// Rotates functions on the sphere: f'(d) = f(R^T d), c' = D(R) c.
/// source: Ivanic & Ruedenberg 1996 with the 1998 correction
class ShRotation {
 public:
  ShRotation(const glm::dmat3& rotation, int bands);

  int bands() const { return bands_; }
  /// Entry D^l_{mn}, -l <= m, n <= l.
  double entry(int l, int m, int n) const;

  template <class Tag>
  ShRgb<Tag> operator*(const ShRgb<Tag>& c) const {
    ShRgb<Tag> out(c.bands());
    apply(c.terms(), out.terms());
    return out;
  }

 private:
  void apply(std::span<const Rgb> in, std::span<Rgb> out) const;
  int bands_;
  std::vector<double> bands_matrices_;  // D^0, D^1, ... row by row
};

// ---------------------------------------------------------------------------------- irradiance

/// A_l of the clamped cosine: pi, 2pi/3, pi/4, 0, -pi/24, 0, ... for any l >= 0.
/// source: Ramamoorthi & Hanrahan 2001, eq. 8
double cosine_coefficient(int l);

/// E_n = A_l l_n: the irradiance of an unshadowed surface as a function of its normal.
IrradianceSh irradiance(const RadianceSh& light);
Rgb evaluate(const IrradianceSh& irradiance, const glm::dvec3& normal);

// ---------------------------------------------------------------------------------- projection

/// Light in spherical harmonics: of the whole sphere, and of the hemisphere above the horizon alone.
struct Projection {
  RadianceSh light;
  RadianceSh above;     // sum over directions with y > 0 only: moments, not a function to evaluate
  double coverage = 1;  // seen part of the sphere's solid angle
};

/// The light for what stands on a horizontal floor. Such a thing gets nothing from below but the floor's own
/// reflection, which the bake accounts for, so the lower hemisphere is free. The coefficients are the
/// least-squares fit of the upper hemisphere, with the weight kBelowWeight on its mirror image below, which
/// is continuous at the horizon. It leaves a half to a tenth of the truncation error of the whole-sphere
/// projection and hardly any bias (docs/accuracy.md), for one small matrix product.
inline constexpr double kBelowWeight =
    .03;  // lower weights win little and blow the coefficients up
RadianceSh floor_light(const RadianceSh& above, int bands);

/// Projects lat-long maps of one size; all tables are made at construction.
/// Each row is reduced to its Fourier sums about +y (quarter-period symmetries folded), weighted by
/// the exact row solid angle and the Legendre functions, and the result is turned from the y to the
/// z pole; the work per pixel is 2 bands - 1 products a channel divided by four.
class LatLongProjector {
 public:
  /// width a multiple of 4, both at least 4; 1 <= bands <= 9
  LatLongProjector(int width, int height, int bands);
  ~LatLongProjector();
  LatLongProjector(LatLongProjector&&) noexcept;
  LatLongProjector& operator=(LatLongProjector&&) noexcept;

  /// in:      linear relative radiance, lat-long, the size given at construction
  /// errors:  kInvalid (size), kNonFinite (first bad pixel)
  /// threads: no allocation
  Result<Projection> project(const Image<Rgb>& map);

 private:
  struct Tables;
  std::unique_ptr<Tables> tables_;
};

/// One call for one map; any width.
/// errors: as LatLongProjector::project, kInvalid (empty)
Result<Projection> project_latlong(const Image<Rgb>& map, int bands);

/// Any camera's pixels: unit directions, solid angles (steradian), confidence 0..1, radiance.
struct LightSamples {
  std::span<const glm::vec3> direction;
  std::span<const float> solid_angle_sr;
  std::span<const float> confidence;  // empty: all 1
  std::span<const Rgb> radiance;
};

/// Projection of pixels that may leave holes. Without holes: l_n = sum w L Y_n. With holes:
/// weighted least squares with the smoothness penalty mu l^2 (l+1)^2 (methods: hole filling), so a
/// constant environment stays exactly constant under any hole.
/// errors:  kInvalid (lengths),
/// kNonFinite, kUndetermined (coverage below 2 %)
Result<Projection> project_samples(const LightSamples& samples, int bands);

// ---------------------------------------------------------------------------------- estimate

/// What an engine asks for.
struct LightEstimate {
  RadianceSh light{1};          // of the whole sphere
  RadianceSh floor_light{1};    // for what stands on a horizontal floor, see floor_light()
  TimestampNs time;             // capture time of the newest frame in it
  bool valid = false;           // false until a first environment has been measured
  double coverage = 0;          // of the sphere
  double clipped_fraction = 0;  // of the sphere's solid angle, saturated in every exposure
  Rgb mean_radiance;            // over the sphere
  /// RMS error over all normals of unshadowed irradiance by leaving out bands >= light.bands(),
  /// relative to the mean irradiance; from the bands up to 9 that were measured.
  double truncation_error = 0;

  Seconds age(TimestampNs now) const { return now - time; }
};

/// Keeps tables between environments of one size.
/// threads: thread-bound; no allocation after the first environment of a size without holes
class LightEstimator {
 public:
  explicit LightEstimator(int bands);
  ~LightEstimator();
  LightEstimator(LightEstimator&&) noexcept;
  LightEstimator& operator=(LightEstimator&&) noexcept;
  /// in: radiance 0 where the confidence is 0
  Result<LightEstimate> estimate(const Environment& environment);

 private:
  Result<Projection> project(const Environment& environment);
  Result<Projection> project_whole(const Image<Rgb>& map);

  std::unique_ptr<class HoleFit> hole_fit_;
  int bands_;
  int width_ = 0, height_ = 0;
  std::unique_ptr<LatLongProjector> projector_;
};

/// A light estimate from a projection on nine bands: truncates and predicts what truncation costs.
LightEstimate make_estimate(const Projection& nine_bands, int bands);

/// Largest possible change of any diffuse surface's exit radiance between two lights, relative to
/// the mean exit radiance under `before`: a hard bound by Cauchy-Schwarz with |t| <= sqrt(2/(3
/// pi)).
double largest_visible_change(const RadianceSh& before, const RadianceSh& after);

}  // namespace penumbra::lighting
