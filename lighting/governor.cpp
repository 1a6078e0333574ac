#include <algorithm>
#include <cmath>
#include <memory_resource>

#include "core/scratch.h"
#include "lighting/governor.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/projection.h"

namespace penumbra::lighting {

namespace {

constexpr double kNegligible_ms = .25;
constexpr double kOwnSteps = .008;  // of bake, maps and interpolation, whatever the light
// Of samples and the form of a light, relative to what the light brings.
constexpr double kTraced = .035;
// Error that a point-like source causes when nine bands hold it, relative to what it brings. Wider
// ones cause less, by what of their energy lies beyond band 8.
constexpr double kBeyondNineBands = .28;

// Fraction of a round source's irradiance-weighted structure that nine bands cannot hold: 1 for a
// point.
double narrowness(const DistantLight& source) {
  constexpr double kHeldByNine = .37;  // radians: 21 degrees, where 81 coefficients suffice
  const double t = source.radius.value() / kHeldByNine;
  return t >= 1 ? 0 : (1 - t) * (1 - t);
}

// s at the probes under harmonics `light`, with `traced` irradiance that is taken care of
// elsewhere.
void add_ratio(const ShadowProbes& probes, const RadianceSh& light, double open, double sign,
               std::span<double> out) {
  if (!(open > 0)) return;
  for (std::size_t p = 0; p < out.size(); ++p) {
    double sum = 0;
    for (int n = 0; n < light.size(); ++n)
      sum += double(luminance(light[n])) *
             double(probes.deficit[p * kMaxCoefficients + static_cast<std::size_t>(n)]);
    out[p] += sign * sum / open;
  }
}

}  // namespace

void ErrorTable::predict(const SplitLight& light, const ShadowProbes& probes, int max_bands,
                         int max_lights) {
  max_bands_ = max_bands;
  max_lights_ = std::min(max_lights, static_cast<int>(light.lights.size()));
  const Scratch::Scope scope;
  std::pmr::vector<double> truth(scope.memory()), difference(probes.count(), scope.memory());
  const glm::dvec3 up(0, 1, 0);
  const auto open_of = [&](const RadianceSh& l) { return luminance(evaluate(irradiance(l), up)); };
  errors_.resize(static_cast<std::size_t>((max_lights_ + 1) * max_bands_));
  for (int lights = max_lights_; lights >= 0; --lights) {
    RadianceSh upper_moments = light.upper_residual->with_bands(kMaxBands);
    double traced = 0, traced_square = 0, beyond = 0;
    for (std::size_t j = 0; j < light.lights.size(); ++j) {
      const DistantLight& d = light.lights[j];
      const double own = luminance(irradiance(d, up));
      if (j < static_cast<std::size_t>(lights)) {
        traced += own;
        traced_square += own * own;
        continue;
      }
      beyond += std::pow(narrowness(d) * own, 2);
      const RadianceSh moments = project_upper_distant_light(d, kMaxBands);
      for (int n = 0; n < kMaxCoefficients; ++n) upper_moments[n] += moments[n];
    }
    const RadianceSh full = upper_hemisphere_light(upper_moments, kMaxBands);
    const double open = std::max(open_of(full) + traced, 1e-30);
    truth.assign(probes.count(), 0);
    add_ratio(probes, full, open, -1, truth);
    for (int bands = 1; bands <= max_bands_; ++bands) {
      const RadianceSh cut = upper_hemisphere_light(upper_moments, bands);
      std::ranges::copy(truth, difference.begin());
      add_ratio(probes, cut, open_of(cut) + traced, 1, difference);
      double square = 0;
      for (const double d : difference) square += d * d;
      if (!difference.empty()) square /= static_cast<double>(difference.size());
      square += (kBeyondNineBands * kBeyondNineBands * beyond + kTraced * kTraced * traced_square) /
                (open * open);
      errors_[static_cast<std::size_t>(lights * max_bands_ + bands - 1)] =
          std::sqrt(square + kOwnSteps * kOwnSteps);
    }
  }
}

Plan Governor::cheapest(const ErrorTable& errors, double budget) const {
  return cheapest(errors, budget, max_lights());
}

Plan Governor::cheapest(const ErrorTable& errors, double budget, int lights_allowed) const {
  Plan best, most_accurate;
  bool found = false;
  double min_error = HUGE_VAL;
  for (int lights = 0; lights <= std::min(errors.max_lights(), lights_allowed); ++lights)
    for (int bands = 1; bands <= std::min(errors.max_bands(), limits_.max_bands); ++bands) {
      Plan plan{bands, lights, factor_ * errors.error(bands, lights), costs_.ms(bands, lights),
                true};
      if (plan.error < min_error) min_error = plan.error, most_accurate = plan;
      if (plan.error > budget || (found && plan.ms >= best.ms)) continue;
      best = plan;
      found = true;
    }
  if (!found) best = most_accurate, best.within_budget = false;
  // Bands that cost next to nothing also serve the objects' own shading, which the prediction does
  // not see.
  while (best.bands < std::min(errors.max_bands(), limits_.max_bands) &&
         costs_.ms(best.bands + 1, best.lights) < best.ms + kNegligible_ms) {
    ++best.bands;
    best.error = factor_ * errors.error(best.bands, best.lights);
  }
  best.ms = costs_.ms(best.bands, best.lights);
  return best;
}

Plan Governor::update(const ErrorTable& errors, TimestampNs now) {
  Plan plan = choose(errors, now);
  plan.time_limited = !plan.within_budget && max_lights() < limits_.max_lights &&
                      cheapest(errors, limits_.budget, limits_.max_lights).lights > plan.lights;
  return plan;
}

Plan Governor::with_unseen(Plan plan, double unseen_above) const {
  const bool kept = plan.error <= limits_.budget;
  plan.error = std::hypot(plan.error, factor_ * kUnseen * unseen_above);
  plan.unseen = kept && plan.error > limits_.budget;
  plan.within_budget = plan.within_budget && !plan.unseen;
  return plan;
}

Plan Governor::choose(const ErrorTable& errors, TimestampNs now) {
  const Plan needed = cheapest(errors, limits_.budget);
  if (!current_ || current_->lights > max_lights()) {
    could_do_less_since_.reset();
    return *(current_ = needed);
  }
  const double present =
      factor_ * errors.error(current_->bands, std::min(current_->lights, errors.max_lights()));
  const bool too_little = present > limits_.budget && needed.error < present;
  const Plan modest = cheapest(errors, kMargin * limits_.budget);
  const bool could_do_less = modest.within_budget && modest.ms < current_->ms;
  if (!could_do_less) could_do_less_since_.reset();
  if (could_do_less && !could_do_less_since_) could_do_less_since_ = now;
  if (too_little) {
    current_ = needed;
    could_do_less_since_.reset();
  } else if (could_do_less && now - *could_do_less_since_ >= kPatience) {
    current_ = modest;
    could_do_less_since_.reset();
  } else {
    current_->error = present;
    current_->within_budget = present <= limits_.budget;
  }
  return *current_;
}

}  // namespace penumbra::lighting
