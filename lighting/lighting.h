// Spherical-harmonic light: projection of environments, rotation, irradiance, the light estimate.
// Conventions (basis, sign, index, units) stand in core/conventions.h alone.
// threads: free functions reentrant; LatLongProjector thread-bound
#pragma once

#include <array>
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/conventions.h"
#include "core/environment.h"
#include "core/image.h"
#include "core/inplace_vector.h"
#include "core/result.h"
#include "core/sh.h"
#include "core/units.h"
#include "lighting/map_luminance.h"
#include "lighting/patched_map.h"

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
  static constexpr int kMostEntries = kMaxBands * (4 * kMaxBands * kMaxBands - 1) / 3;
  std::array<double, kMostEntries> bands_matrices_;  // D^0, D^1, ... row by row
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
  /// threads: internally parallel, the same bits on any number of cores; no allocation
  Result<Projection> project(const Image<Rgb>& map);
  /// The same in two steps, for who looks for sources in between and cuts them out: a map is read once, and of `changed`,
  /// which refers to that map, the changed rows alone. Nothing else is read or projected in between. What is not finite is
  /// found by project_read, and by who looks at the luminance. `luminance` keeps its memory.
  Result<void> read(const Image<Rgb>& map, MapLuminance& luminance);
  Result<Projection> project_read(const PatchedMap& changed);

 private:
  Result<void> check_size(int width, int height) const;
  template <class Map>
  Result<Projection> sum_up(const Map& map) const;
  struct Tables;
  std::unique_ptr<Tables> tables_;
};

/// One call for one map; any width.
/// errors: as LatLongProjector::project, kInvalid (empty)
Result<Projection> project_latlong(const Image<Rgb>& map, int bands);
Result<Projection> project_latlong(const PatchedMap& map, int bands);

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

// ---------------------------------------------------------------------------------- discs

/// A source above the low-frequency rest: uniform radiance over a spherical cap, or over another form of the same
/// solid angle.
struct Disc {
  static constexpr int kShapePoints = 64;
  using Shape = InplaceVector<glm::dvec3, kShapePoints>;

  int id = 0;                     // the same source keeps its number over time (DiscTracker)
  glm::dvec3 direction{0, 1, 0};  // to the centre of its energy, unit
  Radians radius{0};              // half angle
  Rgb radiance;                   // mean over the cap, on top of the rest
  /// Where a round disc would misplace its energy (bands of windows, long lamps): kShapePoints unit directions
  /// of equal energy, neighbours in neighbouring places at every power of two; else empty.
  Shape shape{};
  bool clipped = false;  // saturated in every exposure: its radiance is a lower bound, or completed

  double solid_angle_sr() const;
  /// Of a surface that faces the round disc: L pi sin^2 a.
  Rgb irradiance() const;
};

struct DiscOptions {
  int most = 8;
  /// A source matters when it sends a surface that faces it this share of the mean irradiance.
  double least_share = .02;
};

/// A map in which every source has been cut down to its surroundings, and the sources.
struct DiscSplit {
  PatchedMap rest;
  std::vector<Disc> discs;    // by falling irradiance; ids are not set
  double mean_luminance = 0;  // of the whole map
};

/// Blob peeling: connected regions brighter than six times the mean of what is not one (8-neighbours, across
/// the seam, and around the poles), each cut down to that level. A region of a
/// thousandfold range (a sun in its glow) is peeled in steps, the core first. The energy of rest and discs
/// together is the map's, channel by channel. Works on the full map: reduced to 64 rows a sun would move by up to 1.4
/// degrees.
/// in:      luminance: of this map, see LatLongProjector::read
/// out:     split.rest refers to the map, which must outlive it, and keeps its memory between calls
/// errors:  kInvalid (empty), kNonFinite
/// Every connected region of `clipped` pixels (Environment::clipped) is a disc of its own whatever
/// its share, and before all others where there are more than `most`.
/// source:  after Nowrouzezahrai, Geiger, Mitchell, Sumner, Jarosz & Gross 2011, section 4
Result<void> split_discs(const Image<Rgb>& map, const MapLuminance& luminance,
                         const DiscOptions& options, DiscSplit& split,
                         std::span<const std::uint32_t> clipped = {});
Result<void> split_discs(const Image<Rgb>&& map, const MapLuminance& luminance,
                         const DiscOptions& options, DiscSplit& split,
                         std::span<const std::uint32_t> clipped = {}) = delete;
/// Reads the map itself.
Result<void> split_discs(const Image<Rgb>& map, const DiscOptions& options, DiscSplit& split,
                         std::span<const std::uint32_t> clipped = {});
Result<void> split_discs(const Image<Rgb>&& map, const DiscOptions& options, DiscSplit& split,
                         std::span<const std::uint32_t> clipped = {}) = delete;

/// The disc's own coefficients.
/// source: zonal harmonics of a cap, z_l = sqrt(pi/(2l+1)) (P_{l-1}(cos a) - P_{l+1}(cos a))
RadianceSh project_disc(const Disc& disc, int bands);
/// Moments over directions with y > 0 alone, as Projection::above.
RadianceSh project_disc_above(const Disc& disc, int bands);
/// Of an open surface; the part of the disc behind it is left out.
Rgb irradiance(const Disc& disc, const glm::dvec3& normal);

struct LightEstimate;

/// What a clipped source really sends: its radiance times its solid angle.
struct Completion {
  int disc = 0;  // its id
  Rgb power;
};

/// A matte surface of known albedo that nothing shades, on the scale of the environment's radiance.
struct KnownPatch {
  glm::dvec3 normal{0, 1, 0};
  Rgb radiance;
  Rgb albedo;
};

/// A matte surface on both sides of the edge of the shadow that something real casts in the light
/// of one clipped source. Any scale, any albedo.
struct ShadowEdge {
  glm::dvec3 normal{0, 1, 0};
  Rgb lit, shadowed;
};

/// All clipped discs at once, channel by channel, not negative:
/// E_p - E_unclipped,p = sum_j b_j Int cos+ over disc j.
/// errors:  kInvalid (no clipped disc, bad patch: which), kNonFinite, kUndetermined (fewer patches
///          than clipped discs, no patch sees a disc, patches that do not tell discs apart, nothing
///          left for a disc)
/// source:  Debevec, Graham, Busch & Bolas 2012; least squares of Lawson & Hanson 1974
Result<std::vector<Completion>> complete_from_patches(const LightEstimate& light,
                                                      std::span<const KnownPatch> patches);
/// What one patch says of several clipped discs: they send what it misses, each in proportion to what was measured of
/// it. Where some are sun-like, those alone: a sun or a bulb exceeds what saturates by orders of magnitude, a window by
/// little. The light on the patch comes out right, its share between the discs is a guess.
/// errors:  kInvalid, kNonFinite as complete_from_patches, kUndetermined (the patch sees none of them, nothing left)
Result<std::vector<Completion>> complete_together(const LightEstimate& light,
                                                  const KnownPatch& patch);
/// E_disc = E_others (lit / shadowed - 1).
/// errors:  kInvalid (not a clipped disc, bad edge), kNonFinite, kUndetermined (the surface does not
///          see the disc, the lit side is not brighter)
Result<Completion> complete_from_shadow(const LightEstimate& light, int disc,
                                        const ShadowEdge& edge);

inline constexpr Radians kSunRadius{.2666 * kPi / 180};
/// A clipped region within this of its centre is taken for a sun: its size is the optics' doing.
inline constexpr Radians kSunLike{2 * kPi / 180};
/// The disc with that power, in no channel less than was measured; with the sun's radius if small.
Disc completed(const Disc& measured, const Rgb& power);

/// Completions of tracked discs. Remembered is the radiance over the measured solid angle, so that a
/// source that is half covered later has half the power, and other exposures change nothing.
/// threads: thread-bound
class CompletionMemory {
 public:
  /// errors: kInvalid (not a clipped disc of the newest map), kNonFinite, kUndetermined (less than
  ///         was measured)
  Result<void> remember(const Completion& completion);
  /// Completes the discs and what is left over of them; forgets discs that are clipped no longer.
  void apply(std::vector<Disc>& discs, std::span<Disc> left_over);

 private:
  struct Known {
    int disc;
    Rgb power;  // measured, a lower bound
    double solid_angle_sr;
    std::optional<Rgb> radiance;
  };
  Known* find(int disc);
  std::vector<Known> known_;
};

/// Gives the same source the same number from map to map, and lets a source enter the list over kFade: what it
/// does not carry yet stays in the harmonics, so energy never jumps, only sharpness fades in. A source
/// enters at `DiscOptions::least_share` and leaves below half of it; where sources part or join, what was in the
/// list stays in it.
/// threads: thread-bound
class DiscTracker {
 public:
  static constexpr Seconds kFade{.2};

  /// in:  what split_discs found at half the least share, mean_irradiance = pi times the mean radiance
  /// out: `discs` holds what is used, its radiance times its weight; left_over the rest of it, as discs
  void update(TimestampNs time, double least_share, double mean_irradiance,
              std::vector<Disc>& discs, std::vector<Disc>& left_over);

 private:
  struct Known {
    Disc disc;
    float weight;
  };
  struct Lost {
    Disc disc;
    TimestampNs since;
  };
  struct Found {
    Disc disc;
    std::optional<std::size_t> before;  // in known_
  };
  std::optional<std::size_t> match(const Disc& disc, std::span<const char> taken) const;
  int number_of(const Disc& disc, TimestampNs time);

  std::vector<Known> known_, now_;
  std::vector<Lost> lost_;
  std::vector<Found> found_;
  TimestampNs time_;
  int next_id_ = 1;
  bool first_ = true;
};

// ---------------------------------------------------------------------------------- governor

/// What one light update costs here, fitted where it runs.
struct CostModel {
  double base_ms = .2, per_coefficient_ms = .01, per_disc_ms = 5;
  double ms(int bands, int discs) const {
    return base_ms + per_coefficient_ms * coefficient_count(bands) + per_disc_ms * discs;
  }
};

/// What the prediction needs to know of a light that has been split as far as it goes.
struct SplitLight {
  const RadianceSh* rest_above;  // nine bands of moments over y > 0, without the discs
  std::span<const Disc> discs;   // by falling irradiance
};

/// pi S_n of a scene at points of its floor: [point][n], nine bands (prt::BakedObject::shadow_probes).
struct ShadowProbes {
  std::vector<float> deficit;
  std::size_t count() const { return deficit.size() / kMaxCoefficients; }
};

/// Predicted RMS error of the shadow ratio s for every plan with up to `most_bands` bands and `most_discs` traced
/// discs: what the bands left out would have done at the probes, the share of a disc that is too narrow even
/// for nine bands, and what our own steps cost.
class ErrorTable {
 public:
  ErrorTable() = default;
  ErrorTable(const SplitLight& light, const ShadowProbes& probes, int most_bands, int most_discs) {
    predict(light, probes, most_bands, most_discs);
  }
  /// Anew; keeps its memory.
  void predict(const SplitLight& light, const ShadowProbes& probes, int most_bands, int most_discs);
  int most_bands() const { return most_bands_; }
  int most_discs() const { return most_discs_; }
  double error(int bands, int discs) const {
    return errors_[static_cast<std::size_t>(discs * most_bands_ + bands - 1)];
  }

 private:
  int most_bands_ = 0, most_discs_ = 0;
  std::vector<double> errors_;
};

struct Plan {
  int bands = 5, discs = 0;
  double error = 0;  // predicted, with the factor that holds in 95 % of scenes
  double ms = 0;
  bool within_budget = true;   // false: the most accurate there is
  bool short_of_time = false;  // another disc would be needed, and there is no time for it
};

/// Chooses the cheapest bands and discs whose predicted error, times `kCalibrated`, is within the budget.
/// More at once, less only after two seconds in which four fifths of the budget would have sufficed; discs that there is
/// no time for go at once.
/// threads: thread-bound
/// source: split conformal prediction; factor measured by `chart --governor`, limits in docs/accuracy.md
class Governor {
 public:
  /// 1.76 holds the promise of the shadow (`chart --governor`); what it is more pays for the objects' own shading, which
  /// the prediction does not see: with 2.15 one of the room's lamps was left in harmonics and an object 3.5 % off.
  static constexpr double kCalibrated = 2.3;
  static constexpr Seconds kPatience{2};
  static constexpr double kMargin = .8;

  struct Limits {
    double budget = .05;  // RMS of s
    int most_bands = 5, most_discs = 8;
  };
  /// factor: on predicted errors
  Governor(const Limits& limits, const CostModel& costs, double factor = kCalibrated)
      : limits_(limits), costs_(costs), factor_(factor) {}

  /// What this light needs by itself.
  Plan cheapest(const ErrorTable& errors, double budget) const;
  Plan update(const ErrorTable& errors, TimestampNs now);
  /// From the next update on, at once: discs for which there is time, whatever the limits say.
  void allow_discs(int most) { affordable_discs_ = std::max(most, 0); }
  int most_discs() const { return std::min(limits_.most_discs, affordable_discs_); }

 private:
  Plan cheapest(const ErrorTable& errors, double budget, int most_discs) const;
  Plan choose(const ErrorTable& errors, TimestampNs now);

  Limits limits_;
  int affordable_discs_ = std::numeric_limits<int>::max();
  CostModel costs_;
  double factor_;
  std::optional<Plan> current_;
  std::optional<TimestampNs> could_do_less_since_;
};

// ---------------------------------------------------------------------------------- filter

/// Takes the noise out of the lights of a stream: a Kalman filter with a random walk for every
/// coefficient, its noise measured on the stream itself. A change of 4 sigma of the light as a
/// whole, or of its mean, is another light: everything starts again from the newest map, so that a
/// switched lamp does not fade. Innovations that keep their sign raise the process noise: a light
/// that moves faster than a third of a map's noise per map lags less than one map. A weighted mean
/// of maps, so energy keeps. The first three maps pass unchanged, and so do streams of fewer than
/// one map a second.
/// threads: thread-bound; no heap
class LightFilter {
 public:
  /// Replaces the light by what is known of it now. Time that goes back, or another number of
  /// bands, starts again; a map with NaN is left out: what was known stands in for it.
  void update(TimestampNs time, Projection& light);
  /// Mean weight of the newest map in the estimate: 1 = as measured.
  double gain() const { return gain_; }

 private:
  static constexpr std::size_t kMaps = 4;    // that measure the noise
  static constexpr std::size_t kGroups = 6;  // a channel of the whole light, or of the part above
  struct Value {
    double estimate = 0, variance = 0, noise = 0, own_noise = 0;
    double innovation = 0;  // over its deviation
    float measured = 0;
    std::array<float, kMaps> before{};  // newest first
  };
  int count() const { return 6 * coefficient_count(bands_); }
  static std::size_t at(int i) { return static_cast<std::size_t>(i); }
  std::size_t group(int i) const { return at(i < count() / 2 ? i % 3 : 3 + i % 3); }
  void repeat(Projection& light) const;
  void restart(const Projection& light);
  void start(Value& value) const;
  bool read(const Projection& light);  // whether it differs from the last
  void write(Projection& light) const;
  bool is_another_light(double step_s);
  void correct();
  void remember(double step_s);

  std::array<Value, 6 * kMaxCoefficients> values_{};
  std::array<double, kGroups> energy_{};  // mean square of its coefficients
  std::array<double, kMaps> age_s_{};
  std::size_t maps_ = 0;  // in `before`
  int bands_ = 0, noise_maps_ = 0;
  double move_ = 0;      // process noise of a map over the noise variance
  double surprise_ = 1;  // factor on the expected variance
  double gain_ = 1;
  TimestampNs time_;
  bool known_ = false, was_reset_ = false;
};

// ---------------------------------------------------------------------------------- estimate

/// What an engine asks for.
struct LightEstimate {
  RadianceSh light{1};        // of the whole sphere without the discs
  RadianceSh floor_light{1};  // likewise, for what stands on a horizontal floor, see floor_light()
  std::vector<Disc> discs;    // compact sources, by falling irradiance
  TimestampNs time;           // capture time of the newest frame in it
  bool valid = false;         // false until a first environment has been measured
  double coverage = 0;        // of the sphere
  double clipped_fraction = 0;  // of the sphere's solid angle, saturated in every exposure
  Rgb mean_radiance;            // over the sphere
  /// RMS error over all normals of unshadowed irradiance by leaving out bands >= light.bands(),
  /// relative to the mean irradiance; from the bands up to 9 that were measured, so none for 9.
  std::optional<double> truncation_error;
  std::optional<Plan> plan;  // of a governed estimator

  Seconds age(TimestampNs now) const { return now - time; }
};

/// What a governed estimator is told.
struct Governance {
  Governor::Limits limits;
  CostModel costs;
  ShadowProbes probes;  // of what stands in the scene
};

struct EstimateOptions {
  int bands = 5;
  DiscOptions discs{};  // most = 0: harmonics alone
  bool filter = true;   // of streams, see LightFilter
};

/// Keeps tables between environments of one size.
/// threads: thread-bound; no allocation after the first environment of a size without holes
class LightEstimator {
 public:
  explicit LightEstimator(const EstimateOptions& options);
  ~LightEstimator();
  LightEstimator(LightEstimator&&) noexcept;
  LightEstimator& operator=(LightEstimator&&) noexcept;
  /// From now on bands and discs are the governor's choice within the options'; estimates carry the plan.
  void govern(const Governance& governance);
  /// As Governor::allow_discs; nothing without governance. With none the map is split only now and then, for the
  /// prediction, unless something in it is clipped.
  void allow_discs(int most);
  /// in:  radiance 0 where the confidence is 0
  /// out: keeps its memory; as it was after an error
  Result<void> estimate(const Environment& environment, LightEstimate& out);
  Result<LightEstimate> estimate(const Environment& environment) {
    LightEstimate out;
    PENUMBRA_TRY(estimate(environment, out));
    return out;
  }
  /// From the next map on, as long as the disc is tracked and clipped.
  /// errors: as CompletionMemory::remember
  Result<void> complete(const Completion& completion) { return completions_.remember(completion); }

 private:
  LatLongProjector& projector_for(const Image<Rgb>& map);
  Result<Projection> project(const Image<Rgb>& map);
  Result<Projection> project_rest();
  Result<Projection> fill_holes(const Result<Projection>& moments, const Image<float>& confidence);
  Plan plan_for(const Projection& rest, TimestampNs time);
  Result<void> peel(const Environment& environment);
  void choose_discs();
  Result<Projection> measure_whole(const Environment& environment);
  Result<Projection> measure_split(const Environment& environment);

  std::unique_ptr<class HoleFit> hole_fit_;
  EstimateOptions options_;
  MapLuminance luminance_;
  DiscSplit split_;
  std::vector<Disc> left_over_;  // of the split: what is not used as discs
  DiscTracker tracker_;
  CompletionMemory completions_;
  LightFilter filter_;
  std::optional<Governance> governance_;
  std::optional<Governor> governor_;
  ErrorTable errors_;
  std::optional<Plan> plan_;
  int maps_since_split_ = 0;
  bool without_discs_ = false;  // the map before was measured whole
  int maps_unclipped_ = 0;
  int width_ = 0, height_ = 0;
  std::unique_ptr<LatLongProjector> projector_;
};

/// A light estimate from a projection on nine bands: truncates and predicts what truncation costs. `discs` come
/// on top of the projection.
LightEstimate make_estimate(const Projection& nine_bands, int bands, std::vector<Disc> discs = {});
/// in: discs other than out's own
/// out: keeps its memory
void make_estimate(const Projection& nine_bands, int bands, std::span<const Disc> discs,
                   LightEstimate& out);

/// Of a still map: LightEstimator's first estimate.
/// errors: as LightEstimator::estimate
Result<LightEstimate> estimate_map(const Image<Rgb>& map, const EstimateOptions& options);

/// Discs and rest together in harmonics, for who lights by harmonics alone.
RadianceSh whole_light(const LightEstimate& estimate);
RadianceSh whole_floor_light(const LightEstimate& estimate);

/// Largest possible change of any diffuse surface's exit radiance between two lights, relative to
/// the mean exit radiance under `before`: a hard bound by Cauchy-Schwarz with |t| <= sqrt(2/(3
/// pi)).
double largest_visible_change(const RadianceSh& before, const RadianceSh& after);

}  // namespace penumbra::lighting
