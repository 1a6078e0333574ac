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
/// small matrix product.
inline constexpr double kBelowWeight =
    .03;  // lower weights win little and blow the coefficients up
RadianceSh upper_hemisphere_light(const RadianceSh& upper_moments, int bands);

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
  /// threads: internally parallel, the same bits on any number of cores; no allocation
  Result<ShProjection> project(const Image<Rgb>& map);
  /// The same in two steps, for who looks for sources in between and cuts them out: a map is read
  /// once, and of `changed`, which refers to that map, the changed rows alone. Nothing else is read
  /// or projected in between. What is not finite is found by project_read, and by who looks at the
  /// luminance. `luminance` keeps its memory.
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
/// errors:  kInvalid (lengths),
/// kNonFinite, kUndetermined (coverage below 2 %)
Result<ShProjection> project_samples(const LightSamples& samples, int bands);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
