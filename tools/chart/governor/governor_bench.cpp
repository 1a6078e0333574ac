#include "tools/chart/governor/governor_bench.h"

#include <algorithm>
#include <cmath>

#include "capture/studio/environments.h"

namespace penumbra::tools {

namespace {

constexpr int kMapRows = 512;
constexpr int kReferenceRays = 3000;
constexpr int kCalibration = 59;
constexpr std::uint32_t kFirstCalibration = 1001, kFirstTest = 20001;

double binomial_upper_tail(int successes, int trials, double p) {
  double sum = 0;
  for (int k = successes; k <= trials; ++k)
    sum += std::exp(std::lgamma(trials + 1.) - std::lgamma(k + 1.) - std::lgamma(trials - k + 1.) +
                    k * std::log(p) + (trials - k) * std::log1p(-p));
  return sum;
}

std::vector<lighting::Treatment> all_treatments(const lighting::ErrorTable& table) {
  std::vector<lighting::Treatment> out;
  for (const int step : {1, lighting::kMapBlock})
    for (int lights = 0; lights <= table.max_lights(); ++lights)
      for (int fine = 0; fine <= lights; ++fine)
        for (int bands = 1; bands <= table.max_bands(); ++bands)
          if (step <= table.max_map_step()) out.push_back({bands, lights, fine, step});
  return out;
}

// Scenes in turn, each under a light of its own.
class Trials {
 public:
  Trials(const std::vector<TrialScene>& scenes, std::uint32_t first)
      : scenes_(scenes), seed_(first) {}

  /// errors: kUndetermined (no shadow worth measuring in a hundred scenes), else as Trial::make
  Result<ScenePlans> next() {
    for (int tries = 0; tries < 100; ++tries) {
      const TrialScene& scene = scenes_[seed_ % scenes_.size()];
      const Image<Rgb> map = capture::make_random_environment(2 * kMapRows, kMapRows, seed_++);
      const auto trial = Trial::make(scene, map, kReferenceRays);
      if (trial) return measure_plans(*trial);
      if (trial.error().code != ErrorCode::kUndetermined) return std::unexpected(trial.error());
    }
    return fail(ErrorCode::kUndetermined, "governor", "finds no shadow to measure in 100 scenes");
  }

 private:
  const std::vector<TrialScene>& scenes_;
  std::uint32_t seed_;
};

void count_choice(const ScenePlans& plans, const lighting::Plan& chosen, double budget,
                  GovernorProof& proof) {
  const lighting::PredictedErrors measured = plans.measured_errors(chosen);
  ++proof.promised;
  proof.kept += plans.keeps(chosen, budget) ? 1 : 0;
  proof.mean_shadow += measured.shadow;
  proof.mean_object += measured.object;
  proof.worst_shadow = std::max(proof.worst_shadow, measured.shadow);
  proof.worst_object = std::max(proof.worst_object, measured.object);
  proof.mean_bands += chosen.bands;
  proof.mean_lights += chosen.lights;
  proof.mean_map_step += chosen.map_step;
}

}  // namespace

double clopper_pearson_low(int successes, int trials) {
  if (successes == 0) return 0;
  double low = 0, high = 1;
  for (int i = 0; i < 60; ++i) {
    const double p = (low + high) / 2;
    (p > 0 && p < 1 && binomial_upper_tail(successes, trials, p) < .05 ? low : high) = p;
  }
  return low;
}

ScenePlans measure_plans(const Trial& trial) {
  ScenePlans out{trial.predicted(), {}};
  for (const lighting::Treatment& t : all_treatments(out.predicted))
    out.measured.emplace_back(t, trial.measured(t));
  return out;
}

lighting::PredictedErrors ScenePlans::measured_errors(const lighting::Treatment& t) const {
  const auto found = std::ranges::find(measured, t, [](const auto& m) { return m.first; });
  return found == measured.end() ? lighting::PredictedErrors{HUGE_VAL, HUGE_VAL} : found->second;
}

std::optional<lighting::Plan> ScenePlans::choose(const lighting::CostModel& costs, double budget,
                                                 double factor) const {
  const lighting::Governor governor({budget, predicted.max_bands(), predicted.max_lights()}, costs,
                                    factor);
  const lighting::Plan plan = governor.cheapest(predicted, budget);
  return plan.within_budget ? std::optional(plan) : std::nullopt;
}

double ScenePlans::min_factor(const lighting::CostModel& costs, double budget) const {
  // The choice changes where a treatment leaves the budget: just above budget/predicted.
  std::vector<double> factors{0};
  for (const auto& [treatment, errors] : measured)
    factors.push_back(budget / predicted.errors(treatment).larger() * (1 + 1e-9));
  std::ranges::sort(factors, std::greater<>());
  double smallest = factors.front();
  for (const double factor : factors) {
    const auto chosen = choose(costs, budget, factor);
    if (chosen && !keeps(*chosen, budget)) return smallest;
    smallest = factor;
  }
  return 0;
}

std::optional<double> ScenePlans::regret(const lighting::CostModel& costs, double budget,
                                         const lighting::Plan& plan) const {
  double cheapest_ms = HUGE_VAL;
  for (const auto& [treatment, errors] : measured)
    if (errors.larger() <= budget)
      cheapest_ms = std::min(cheapest_ms, predicted.cost(treatment, costs).ms());
  return std::isfinite(cheapest_ms) ? std::optional(plan.ms / cheapest_ms) : std::nullopt;
}

Result<GovernorProof> prove_governor(const std::vector<TrialScene>& calibration,
                                     const std::vector<TrialScene>& others,
                                     const lighting::CostModel& costs, double budget,
                                     int test_scenes, const std::function<void(double)>& progress) {
  GovernorProof proof;
  const auto tell = [&] {
    if (progress) progress(double(proof.calibration + proof.scenes) / (kCalibration + test_scenes));
  };
  for (Trials trials(calibration, kFirstCalibration); proof.calibration < kCalibration;) {
    PENUMBRA_ASSIGN(plans, trials.next());
    for (const double b : kBudgets)
      proof.needed_factor = std::max(proof.needed_factor, plans.min_factor(costs, b));
    ++proof.calibration;
    tell();
  }
  proof.factor = std::max(proof.needed_factor, lighting::Governor::kConformalFactor);
  std::vector<double> regrets;
  for (Trials trials(others, kFirstTest); proof.scenes < test_scenes;) {
    PENUMBRA_ASSIGN(plans, trials.next());
    ++proof.scenes;
    tell();
    const auto chosen = plans.choose(costs, budget, proof.factor);
    if (!chosen) continue;  // it says that it cannot
    count_choice(plans, *chosen, budget, proof);
    if (const auto regret = plans.regret(costs, budget, *chosen)) regrets.push_back(*regret);
  }
  for (double* mean : {&proof.mean_shadow, &proof.mean_object, &proof.mean_bands,
                       &proof.mean_lights, &proof.mean_map_step})
    *mean /= std::max(1, proof.promised);
  std::ranges::sort(regrets);
  if (!regrets.empty()) {
    proof.median_regret = regrets[regrets.size() / 2];
    proof.worst_regret = regrets.back();
  }
  proof.coverage_low = clopper_pearson_low(proof.kept, proof.promised);
  return proof;
}

}  // namespace penumbra::tools
