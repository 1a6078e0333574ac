// Calibrates the governor on scenes drawn at random and proves its promise on others.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "core/result.h"
#include "lighting/governor.h"
#include "runtime/scene/scene.h"

namespace penumbra::tools {

/// Errors of s at the probes of a scene in one environment: predicted, and measured for every plan.
struct ScenePlans {
  std::uint32_t seed = 0;
  lighting::ErrorTable predicted;
  std::vector<double> measured;  // RMS of s where the reference is below .95; as the table's order

  double measured_error(const lighting::Plan& plan) const {
    return measured[static_cast<std::size_t>(plan.lights * predicted.max_bands() + plan.bands - 1)];
  }
  /// The governor's choice with this factor; nothing when it finds none within the budget.
  std::optional<lighting::Plan> choose(const lighting::CostModel& costs, double budget,
                                       double factor) const;
  /// The smallest factor from which on every choice within `budget` keeps it; 0 when any does.
  double min_factor(const lighting::CostModel& costs, double budget) const;
};

/// The shadow of the scene's first object on its floor in random environment `seed`, by reference
/// rays and by every plan.
/// errors: kUndetermined (no shadow worth measuring), else as the parts
Result<ScenePlans> measure_plans(const runtime::PreparedScene& scene, std::uint32_t seed, int rays);

/// Lowest success probability that k successes of n leave possible with 95 % confidence, one-sided.
/// source: Clopper & Pearson 1934
double clopper_pearson_low(int successes, int trials);

struct GovernorProof {
  double needed_factor = 0;  // the largest min_factor of the calibration scenes over kBudgets
  double factor = 0;         // that the promise was made with
  int calibration = 0, scenes = 0, promised = 0, kept = 0;
  double coverage_low = 0;  // Clopper-Pearson
  double mean_regret = 0;   // cost over the cheapest plan that truly is within the budget, minus 1
  double mean_error = 0, worst_error = 0;  // of the chosen plans
  double mean_bands = 0, mean_lights = 0;
};

/// Budgets that one factor serves.
inline constexpr double kBudgets[] = {.02, .03, .05, .08};

/// 59 scenes calibrate (95 % coverage with 95 % confidence), `test_scenes` others prove with the
/// larger of their factor and the program's own. The scenes of either are numbered from fixed
/// starts of their own: neither was looked at to shape the prediction.
/// source: split conformal prediction, the loss of a choice instead of a residual
Result<GovernorProof> prove_governor(const runtime::PreparedScene& scene,
                                     const lighting::CostModel& costs, double budget,
                                     int test_scenes, const std::function<void(double)>& progress);

}  // namespace penumbra::tools
