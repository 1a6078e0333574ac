// Projection of environments onto spherical harmonics.
// threads: free functions reentrant; LatLongProjector thread-bound
#pragma once

#include <glm/vec3.hpp>
#include <memory>
#include <span>

#include "core/image.h"
#include "core/result.h"
#include "core/sh.h"
#include "lighting/sh/map_luminance.h"
#include "lighting/sh/row_overlay.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// Light in spherical harmonics: of the whole sphere, and of the hemisphere above the horizon
/// alone.
struct ShProjection {
  RadianceSh light;
  // Sum over directions with y > 0 only: moments, not a function to evaluate
  RadianceSh upper_moments;
  double coverage = 1;  // seen part of the sphere's solid angle
};

/// The light for what stands on a horizontal floor. Such a thing gets nothing from below but the
/// floor's own reflection, which the bake accounts for, so the lower hemisphere is free. The
/// coefficients are the least-squares fit of the upper hemisphere, with the weight kBelowWeight on
/// its mirror image below, which is continuous at the horizon. It leaves a half to a tenth of the
/// truncation error of the whole-sphere projection and hardly any bias (docs/results.md), for one
/// small matrix product. Lower weights win little and blow the coefficients up.
inline constexpr double kBelowWeight = .03;
RadianceSh upper_hemisphere_light(const RadianceSh& upper_moments, int bands);

/// Projects lat-long maps of one size; all tables are made at construction.
/// Each row is reduced to its Fourier sums about +y (quarter-period symmetries folded). They are
/// weighted by the exact row solid angle and the Legendre functions. The result is turned from the
/// y to the z pole. The work per pixel is 2 bands - 1 products a channel, divided by four.
class LatLongProjector {
 public:
  /// width a multiple of 4, both at least 4; 1 <= bands <= 9
  LatLongProjector(int width, int height, int bands);
  ~LatLongProjector();
  LatLongProjector(LatLongProjector&&) noexcept;
  LatLongProjector& operator=(LatLongProjector&&) noexcept;

  /// in:      linear relative radiance, lat-long, the size given at construction
  /// errors:  kInvalid (size), kNonFinite (first bad pixel)
  /// threads: internally parallel, the same bits on any number of cores; no allocation
  Result<ShProjection> project(const Image<Rgb>& map);
  /// Two-pass variant, where sources are cut out of the map in between: `read()` caches row sums;
  /// `project_read()` recomputes only rows changed since. No other map comes between the two.
  /// in:      changed: refers to the map that was read
  /// out:     luminance: of the map; keeps its memory
  /// errors:  kInvalid (size); project_read: kNonFinite as project()
  Result<void> read(const Image<Rgb>& map, MapLuminance& luminance);
  Result<ShProjection> project_read(const RowOverlay& changed);

 private:
  Result<void> check_size(int width, int height) const;
  template <class Map>
  Result<ShProjection> sum_up(const Map& map) const;
  struct Tables;
  std::unique_ptr<Tables> tables_;
};

/// One call for one map; any width.
/// errors: as LatLongProjector::project, kInvalid (empty)
Result<ShProjection> project_latlong(const Image<Rgb>& map, int bands);
Result<ShProjection> project_latlong(const RowOverlay& map, int bands);

/// Any camera's pixels: unit directions, solid angles (steradian), confidence 0..1, radiance.
struct LightSamples {
  std::span<const glm::vec3> direction;
  std::span<const float> solid_angle_sr;
  std::span<const float> confidence;  // empty: all 1
  std::span<const Rgb> radiance;
};

/// ShProjection of pixels that may leave holes. Without holes: l_n = sum w L Y_n. With holes:
/// weighted least squares with the smoothness penalty mu l^2 (l+1)^2
/// (docs/methods/environment-assembly.md), so a constant environment stays exactly constant under
/// any hole.
/// errors:  kInvalid (lengths), kNonFinite, kUndetermined (coverage below 2 %)
Result<ShProjection> project_samples(const LightSamples& samples, int bands);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
