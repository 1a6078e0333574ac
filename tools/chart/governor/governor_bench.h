// Calibrates the governor on scenes drawn at random and proves its promise on others.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "core/result.h"
#include "lighting/governor.h"
#include "tools/chart/governor/governor_trial.h"

namespace penumbra::tools {

/// Lowest success probability that k successes of n leave possible with 95 % confidence, one-sided.
/// source: Clopper & Pearson 1934
double clopper_pearson_low(int successes, int trials);

/// All that a governor may choose from under one light, each with its true errors.
struct ScenePlans {
  lighting::ErrorTable predicted;
  std::vector<std::pair<lighting::Treatment, lighting::PredictedErrors>> measured;

  /// in: one of `measured`
  lighting::PredictedErrors measured_errors(const lighting::Treatment& treatment) const;
  bool keeps(const lighting::Treatment& treatment, double budget) const {
    return measured_errors(treatment).larger() <= budget;
  }
  /// The governor's choice with this factor; nothing when it finds none within the budget.
  std::optional<lighting::Plan> choose(const lighting::CostModel& costs, double budget,
                                       double factor) const;
  /// The smallest factor from which on every choice within `budget` keeps it; 0 when any does.
  double min_factor(const lighting::CostModel& costs, double budget) const;
  /// Cost over that of the cheapest treatment that truly keeps the budget; nothing where none does.
  std::optional<double> regret(const lighting::CostModel& costs, double budget,
                               const lighting::Plan& plan) const;
};
ScenePlans measure_plans(const Trial& trial);

struct GovernorProof {
  int calibration = 0, scenes = 0, promised = 0, kept = 0;
  double needed_factor = 0;  // the largest min_factor of the calibration scenes over kBudgets
  double factor = 0;         // that the promise was made with
  double coverage_low = 0;   // Clopper-Pearson
  double median_regret = 0, worst_regret = 0;
  // Of what was chosen:
  double mean_shadow = 0, worst_shadow = 0, mean_object = 0, worst_object = 0;
  double mean_bands = 0, mean_lights = 0, mean_map_step = 0;
};

/// Budgets that one factor serves.
inline constexpr double kBudgets[] = {.03, .05, .08};

/// 59 scenes of `calibration` (95 % coverage with 95 % confidence), then `test_scenes` of `others`
/// prove with the larger of their factor and the program's own. The lights of either are numbered
/// from fixed starts of their own: neither was looked at to shape the prediction.
/// source: split conformal prediction, the loss of a choice instead of a residual
Result<GovernorProof> prove_governor(const std::vector<TrialScene>& calibration,
                                     const std::vector<TrialScene>& others,
                                     const lighting::CostModel& costs, double budget,
                                     int test_scenes, const std::function<void(double)>& progress);

}  // namespace penumbra::tools
