// The cheapest bands and light sources that keep to an error budget.
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

/// What one light update costs here, fitted where it runs.
struct CostModel {
  double base_ms = .2, per_coefficient_ms = .01, per_light_ms = 5;
  double ms(int bands, int lights) const {
    return base_ms + per_coefficient_ms * coefficient_count(bands) + per_light_ms * lights;
  }
};

/// What the prediction needs to know of a light that has been split as far as it goes.
struct SplitLight {
  const RadianceSh* upper_residual;      // nine bands of moments over y > 0, without the lights
  std::span<const DistantLight> lights;  // by falling irradiance
};

/// pi S_n of a scene at points of its floor: [point][n], nine bands
/// (prt::BakedObject::shadow_probes).
struct ShadowProbes {
  std::vector<float> deficit;
  std::size_t count() const { return deficit.size() / kMaxCoefficients; }
};

/// Predicted RMS error of the shadow ratio s for every plan with up to `max_bands` bands and
/// `max_lights` traced lights. It counts what the bands left out would have done at the probes, the
/// fraction of a light that is too narrow even for nine bands, and what our own steps cost.
class ErrorTable {
 public:
  ErrorTable() = default;
  ErrorTable(const SplitLight& light, const ShadowProbes& probes, int max_bands, int max_lights) {
    predict(light, probes, max_bands, max_lights);
  }
  /// Anew; keeps its memory.
  void predict(const SplitLight& light, const ShadowProbes& probes, int max_bands, int max_lights);
  int max_bands() const { return max_bands_; }
  int max_lights() const { return max_lights_; }
  double error(int bands, int lights) const {
    return errors_[static_cast<std::size_t>(lights * max_bands_ + bands - 1)];
  }

 private:
  int max_bands_ = 0, max_lights_ = 0;
  std::vector<double> errors_;
};

struct Plan {
  int bands = 5, lights = 0;
  double error = 0;  // predicted, with the factor that holds in 95 % of scenes; see lower_bound
  double ms = 0;
  bool within_budget = true;  // false: the most accurate there is, and what costs nothing
  bool time_limited = false;  // another light would be needed, and there is no time for it
  /// A light is saturated in every exposure and not recovered. `error` is that of the light as it
  /// was measured; the true one is unknown, and nothing is within the budget.
  bool lower_bound = false;
  /// What no camera sees is more than the budget lets pass: `error` counts it, and no plan helps.
  bool unseen = false;
};

/// Chooses the cheapest bands and lights whose predicted error, times `kConformalFactor`, is within
/// the budget. Takes more at once, and less only after two seconds in which four fifths of the
/// budget would have sufficed. Lights that there is no time for go at once.
/// threads: thread-bound
/// source: split conformal prediction; factor measured by `chart --governor`, limits in
///         docs/methods/governor.md
class Governor {
 public:
  /// More than the promise of the shadow needs (docs/results.md): the rest pays for the objects'
  /// own shading, which the prediction does not see. With 2.15 one of the room's lamps was left in
  /// harmonics and an object 3.5 % off.
  static constexpr double kConformalFactor = 2.3;
  static constexpr Seconds kPatience{2};
  static constexpr double kMargin = .8;
  /// RMS error of s for each part of the floor's view of the sky that no camera sees. Continued
  /// from the rest, the irradiance from there is off by a third in the RMS
  /// (docs/methods/governor.md), half of which shows in a ratio.
  static constexpr double kUnseen = .175;

  struct Limits {
    double budget = .05;  // RMS of s
    int max_bands = 5, max_lights = 8;
  };
  /// factor: on predicted errors
  Governor(const Limits& limits, const CostModel& costs, double factor = kConformalFactor)
      : limits_(limits), costs_(costs), factor_(factor) {}

  /// What this light needs by itself.
  Plan cheapest(const ErrorTable& errors, double budget) const;
  Plan update(const ErrorTable& errors, TimestampNs now);
  /// From the next update on, at once: lights for which there is time, whatever the limits say.
  void allow_lights(int max_count) { affordable_lights_ = std::max(max_count, 0); }
  /// The plan, with what no camera sees of the floor's view of the sky counted in.
  Plan with_unseen(Plan plan, double unseen_above) const;
  int max_lights() const { return std::min(limits_.max_lights, affordable_lights_); }

 private:
  Plan cheapest(const ErrorTable& errors, double budget, int max_lights) const;
  Plan choose(const ErrorTable& errors, TimestampNs now);

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
  ShadowProbes probes;  // of what stands in the scene
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
