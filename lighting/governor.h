// The cheapest treatment of a light that keeps to an error budget: which knob is turned how far.
// threads: Governor thread-bound, the rest reentrant
#pragma once

#include <algorithm>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "core/sh.h"
#include "core/units.h"
#include "lighting/lights/distant_light.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

/// How one light is modelled.
struct Treatment {
  int bands = 5;   // of spherical harmonics
  int lights = 0;  // traced, by falling irradiance; the others are in the harmonics
  /// So many of them cast finely drawn shadows on planes, the others coarse ones where they are
  /// narrow (shadows::ShadowMapOptions::coarse()).
  int fine_lights = 0;
  int map_step = 1;  // the map is read as it is, or in blocks of kMapBlock pixels squared
  bool operator==(const Treatment&) const = default;
};
inline constexpr int kMapBlock = 4;
inline constexpr Radians kWideLight{.05};  // radius from which a light counts as wide

/// Times of one light update on one thread, by what takes them.
struct UpdateCost {
  double reading_ms = 0, relighting_ms = 0, lights_ms = 0;
  double ms() const { return reading_ms + relighting_ms + lights_ms; }
};

/// What a light update costs here, fitted where it runs.
struct CostModel {
  double relight_ms = .1;
  /// Hardly anything, as a bake is read whole; but of two treatments that cost the same the one
  /// with fewer bands is taken.
  double per_coefficient_ms = .001;
  /// Of one light, with its shadow on planes; the direct light of a wide one is looked up in what
  /// was baked.
  double fine_light_ms = 1.6, coarse_light_ms = 1.3, wide_light_ms = .7;
  /// Of a map of 512 rows, as it is and in blocks; others by their number of pixels.
  double read_ms = .55, read_blocks_ms = .25;
};

/// What the prediction needs to know of a light that has been split as far as it goes.
struct SplitLight {
  const RadianceSh* upper_residual;      // nine bands of moments over y > 0, without the lights
  std::span<const DistantLight> lights;  // by falling irradiance
  int map_rows = 512;                    // of the map that they come from
  int max_map_step = kMapBlock;          // 1: its pixels cannot be averaged
};

/// Where errors of a scene are predicted.
struct SceneProbes {
  /// pi S_n at points of the floor: [point][n], nine bands (prt::BakedObject::shadow_probes).
  std::vector<float> deficit;
  /// t_n at points of the objects, green: [point][n]; none: their light is taken for the floor's.
  std::vector<float> transfer;
  int transfer_bands = 0;
  /// Whether anything casts its shadow on a floor.
  bool has_floor = true;
  /// Whether all floors that something stands on are level: the light of others is cut without the
  /// floor's help.
  bool level = true;
  /// Whether planes are all that is real, and every object stands on one. In the shade of a real
  /// mesh, or in the air, all directions count.
  bool on_planes_only = true;
  /// Else all of them are taken.
  bool tell_of_bands() const {
    return level && on_planes_only && floor_points() + object_points() > 0;
  }
  std::size_t floor_points() const { return deficit.size() / kMaxCoefficients; }
  std::size_t object_points() const {
    return transfer.size() /
           static_cast<std::size_t>(std::max(1, coefficient_count(transfer_bands)));
  }
};

/// RMS errors: of the shadow ratio s, and of the objects' radiance relative to its own RMS.
struct PredictedErrors {
  double shadow = 0, object = 0;
  double larger() const { return std::max(shadow, object); }
};

/// Predicted errors of every treatment with up to `max_bands` bands and `max_lights` lights.
/// They count what the bands left out would have done at the probes, what of a light is too narrow
/// for harmonics, and what our own steps cost.
/// source: docs/methods/governor.md
class ErrorTable {
 public:
  ErrorTable() = default;
  ErrorTable(const SplitLight& light, const SceneProbes& probes, int max_bands, int max_lights) {
    predict(light, probes, max_bands, max_lights);
  }
  /// Anew; keeps its memory.
  void predict(const SplitLight& light, const SceneProbes& probes, int max_bands, int max_lights);
  int max_bands() const { return max_bands_; }
  int max_lights() const { return max_lights_; }
  int max_map_step() const { return max_map_step_; }
  /// in: lights at most max_lights(); more are taken for that many
  PredictedErrors errors(const Treatment& treatment) const;
  /// Of the bands left out alone.
  PredictedErrors errors_of_bands(int bands, int lights) const;
  UpdateCost cost(const Treatment& treatment, const CostModel& costs) const;

 private:
  // Mean squares of the ratio and of the objects' relative radiance.
  struct Squares {
    double shadow = 0, object = 0;
  };
  // What so many bands and lights leave out.
  struct Omitted {
    Squares bands, lights;
  };
  // What the first so many lights' own treatment costs.
  struct Traced {
    Squares fine, coarse, in_blocks;
  };
  struct Parts;
  void predict_traced(const SplitLight& light, const Parts& parts);
  void predict_bands(int lights, const RadianceSh& moments, double traced_irradiance,
                     const SceneProbes& probes, const Parts& parts);
  const Omitted& omitted(int bands, int lights) const {
    return omitted_[static_cast<std::size_t>(lights * max_bands_ + bands - 1)];
  }
  int max_bands_ = 0, max_lights_ = 0, map_rows_ = 0, max_map_step_ = 1;
  double own_ = 0;  // of our own steps
  std::vector<Omitted> omitted_;
  std::vector<Traced> traced_;  // by number of lights
  std::vector<int> wide_;       // how many of so many lights are wide
};

struct Plan : Treatment {
  double error = 0;  // of the shadow: predicted, with the factor that holds in 95 % of scenes
  double object_error = 0;  // likewise, of the objects' radiance
  double ms = 0;
  UpdateCost cost;            // what takes them
  bool within_budget = true;  // false: the most accurate there is
  bool time_limited = false;  // another light would be needed, and there is no time for it
  /// A light is saturated in every exposure and not recovered. `error` is that of the light as it
  /// was measured; the true one is unknown, and nothing is within the budget.
  bool lower_bound = false;
  /// What no camera sees is more than the budget lets pass: `error` counts it, and no plan helps.
  bool unseen = false;
};

/// Chooses the cheapest treatment whose predicted errors, times `kConformalFactor`, are both within
/// the budget. Takes more at once, and less only after two seconds in which four fifths of the
/// budget would have sufficed. Lights that there is no time for go at once.
/// threads: thread-bound
/// source: split conformal prediction; factor measured by `chart --governor`, limits in
///         docs/methods/governor.md
class Governor {
 public:
  static constexpr double kConformalFactor = 2.1;
  static constexpr Seconds kPatience{2};
  static constexpr double kMargin = .8;
  /// Bands cost so little that what is left out may take no more of the budget, and never what
  /// engines expect at least.
  static constexpr double kBandsPart = .2;
  static constexpr int kMinBands = 3;
  /// RMS error of s for each part of the floor's view of the sky that no camera sees: continued
  /// from the rest, the irradiance from there was off by .35 in the RMS of ten maps (half of the
  /// sphere, or a cone of 60 degrees, hidden from four sides), half of which shows in a ratio.
  static constexpr double kUnseen = .175;

  struct Limits {
    double max_error = .05;  // RMS, of the shadow ratio and of the objects
    int max_bands = 5, max_lights = 8;
  };
  /// factor: on predicted errors
  Governor(const Limits& limits, const CostModel& costs, double factor = kConformalFactor)
      : limits_(limits), costs_(costs), factor_(factor) {}

  /// What this light needs by itself.
  Plan cheapest(const ErrorTable& errors, double budget) const;
  Plan update(const ErrorTable& errors, TimestampNs now);
  /// A treatment with its promise and its cost.
  Plan judge(const ErrorTable& errors, const Treatment& treatment, double budget) const;
  /// From the next update on, at once: lights for which there is time, whatever the limits say.
  void allow_lights(int max_count) { affordable_lights_ = std::max(max_count, 0); }
  /// The plan, with what no camera sees of the floor's view of the sky counted in.
  Plan with_unseen(Plan plan, double unseen_above) const;
  bool is_hurried() const { return affordable_lights_ < limits_.max_lights; }
  int max_lights() const { return std::min(limits_.max_lights, affordable_lights_); }

 private:
  Plan cheapest(const ErrorTable& errors, double budget, int max_lights) const;
  Plan choose(const ErrorTable& errors, TimestampNs now);
  bool takes_too_few_bands(const ErrorTable& errors, const Treatment& t, double budget) const;
  Treatment at_least(const Treatment& now, const Treatment& needed) const;

  Limits limits_;
  int affordable_lights_ = std::numeric_limits<int>::max();
  CostModel costs_;
  double factor_;
  std::optional<Plan> current_;
  std::optional<TimestampNs> could_do_less_since_;
};

/// What a governed estimator is told.
struct GovernorConfig {
  Governor::Limits limits;
  CostModel costs;
  SceneProbes probes;  // of what stands in the scene
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
