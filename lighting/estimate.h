// Environments in, light estimates out.
// threads: free functions reentrant; LightEstimator thread-bound
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/environment.h"
#include "core/image.h"
#include "core/result.h"
#include "core/sh.h"
#include "core/units.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "lighting/light_filter.h"
#include "lighting/lights/distant_light.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/lights/light_tracker.h"
#include "lighting/lights/sun.h"
#include "lighting/saturation_recovery.h"
#include "lighting/sh/map_luminance.h"
#include "lighting/sh/projection.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

struct EstimateOptions {
  int bands = 5;
  ExtractionOptions lights{};  // max_count = 0: harmonics alone
  bool filter = true;          // of streams, see LightFilter
  /// 1, or kMapBlock: maps are read averaged over blocks of so many pixels squared, where nothing
  /// in them is clipped or hidden and their size allows. A governor overrules it.
  int map_step = 1;
  /// Where the sun is known to stand. Where no camera sees that place it is a light of unknown
  /// power (kUnseenSun) from the first map on.
  std::optional<SunSite> sun{};
};

/// Keeps tables between environments of one size, and of its blocks.
/// threads: thread-bound; no allocation after the first environment of a size without holes
class LightEstimator {
 public:
  explicit LightEstimator(const EstimateOptions& options);
  ~LightEstimator();
  LightEstimator(LightEstimator&&) noexcept;
  LightEstimator& operator=(LightEstimator&&) noexcept;
  /// From now on bands, lights and map step are the governor's choice, bands and lights within the
  /// options'; estimates carry the plan.
  void set_governor(const GovernorConfig& governor_config);
  /// So many lights a frame has the time for: the plan has no more. The estimate still holds all
  /// that the light needs, see keep_affordable(). Nothing without a governor.
  void allow_lights(int max_count);
  /// From now on estimates say what surfaces of these roughnesses mirror.
  /// size_factor: as of ReflectionFilter
  void mirror(const SurfaceRoughness& surfaces, float size_factor = 1);
  /// in:  radiance 0 where the confidence is 0
  /// out: keeps its memory; as it was after an error
  Result<void> estimate(const Environment& environment, LightEstimate& out);
  Result<LightEstimate> estimate(const Environment& environment) {
    LightEstimate out;
    PENUMBRA_TRY(estimate(environment, out));
    return out;
  }
  /// Whether what no map shows is known not to be shown: false while cameras have yet to come.
  void look_for_unseen_sun(bool look) { looks_for_sun_ = look; }
  /// From the next map on, as long as the light is tracked and clipped.
  /// errors: as RecoveryMemory::remember
  Result<void> add_recovery(const SaturationRecovery& recovery) {
    return recoveries_.remember(recovery);
  }

 private:
  LatLongProjector& projector_for(const Image<Rgb>& map);
  Result<ShProjection> project(const Image<Rgb>& map);
  Result<ShProjection> project_residual();
  void follow_holes(const Image<float>& confidence);
  Result<ShProjection> fill_holes(const Result<ShProjection>& moments) const;
  void plan_for(const ShProjection& residual, TimestampNs time);
  const Environment* in_blocks(const Environment& environment);
  void find_unseen_sun(const Environment& environment);
  Result<void> extract(const Environment& environment);
  void choose_max_lights();
  Result<ShProjection> measure(const Environment& environment);
  void tell_uncertainty(bool lower_bound, LightEstimate& out) const;
  void cut_out(const DistantLight& light, Image<Rgb>& map) const;
  void find_reflections(const Environment& whole_map, LightEstimate& out);

  std::unique_ptr<class ShInpainting> inpainting_;  // of the newest map; null without holes
  EstimateOptions options_;
  MapLuminance luminance_;
  LightExtraction extraction_;
  std::vector<DistantLight> unused_;  // of the split: what is not used as lights
  LightTracker tracker_;
  RecoveryMemory recoveries_;
  LightFilter filter_;
  std::optional<GovernorConfig> governor_config_;
  std::optional<Governor> governor_, unhurried_;  // with the time of a frame, and with any
  ErrorTable errors_;
  std::optional<Plan> plan_, unhurried_plan_;
  Environment in_blocks_;
  int map_rows_ = 0, max_map_step_ = 1;  // of the newest map, as it came
  bool looks_for_sun_ = true;
  std::optional<glm::dvec3> unseen_sun_;  // towards it; it stands above the horizon
  std::optional<TimestampNs> first_;      // map, to which the sun's time belongs
  struct SizedProjector {
    int width = 0, height = 0;
    std::unique_ptr<LatLongProjector> projector;
    bool is_for(const Image<Rgb>& map) const {
      return projector && width == map.width() && height == map.height();
    }
  };
  std::array<SizedProjector, 2> projectors_;  // of a map as it is, and in blocks
  std::optional<ReflectionFilter> mirror_;
  Image<Rgb> mirrored_map_;                // scratch
  LatLongProjector* projector_ = nullptr;  // of them, which the newest map was read by
};

/// The light of one map of which a part was not seen, on nine bands.
struct SeenLight {
  ShProjection whole;
  RadianceSh residual;  // without compact lights: what goes on where nothing was seen
};
/// Compact lights are taken out before the rest is continued: smoothly through a sun, it would ring
/// over all that is unseen.
/// in:     the confidence is not empty
/// errors: as project_latlong and ShInpainting::fill
Result<SeenLight> project_seen(const Environment& environment);

/// A light estimate from a projection on nine bands: truncates and predicts what truncation costs.
/// `lights` come on top of the projection.
LightEstimate make_estimate(const ShProjection& nine_bands, int bands,
                            std::vector<DistantLight> lights = {});
/// in: lights other than out's own
/// out: keeps its memory
void make_estimate(const ShProjection& nine_bands, int bands, std::span<const DistantLight> lights,
                   LightEstimate& out);

/// Of a still map: LightEstimator's first estimate.
/// errors: as LightEstimator::estimate
Result<LightEstimate> estimate_map(const Image<Rgb>& map, const EstimateOptions& options);

/// Lights and rest together in harmonics, for who lights by harmonics alone.
RadianceSh whole_light(const LightEstimate& estimate);
RadianceSh whole_upper_hemisphere_light(const LightEstimate& estimate);

/// Largest possible change of any diffuse surface's exit radiance between two lights, relative to
/// the mean exit radiance under `before`: a hard bound by Cauchy-Schwarz with |t| <= sqrt(2/(3
/// pi)).
double largest_visible_change(const RadianceSh& before, const RadianceSh& after);

}  // namespace penumbra::lighting
#pragma GCC visibility pop
