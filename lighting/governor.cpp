#include <algorithm>
#include <cmath>

#include "lighting/lighting.h"

namespace penumbra::lighting {

namespace {

constexpr double kOwnSteps = .01;  // of bake, maps and interpolation, whatever the light
// A narrow source goes on beyond the ninth band: with |l|^2/(2l+1) constant and shadow power falling as 1/l^2,
// all bands from 9 on weigh what eight times band 8 does.
constexpr double kBeyond = 8;

double band_energy(const RadianceSh& light, int l) {
  double sum = 0;
  for (int n = coefficient_count(l); n < coefficient_count(l + 1); ++n)
    sum += std::pow(double(luminance(light[n])), 2);
  return sum / (2 * l + 1);
}

}  // namespace

double predicted_error(const SplitLight& light, int bands, int discs) {
  RadianceSh harmonics = light.rest->with_bands(kMaxBands);
  double beyond = 0;
  for (std::size_t k = static_cast<std::size_t>(discs); k < light.discs.size(); ++k) {
    const RadianceSh own = project_disc(light.discs[k], kMaxBands);
    for (int n = 0; n < kMaxCoefficients; ++n) harmonics[n] += own[n];
    beyond += kBeyond * band_energy(own, kMaxBands - 1);
  }
  double square = beyond * light.shadow_power[kMaxBands - 1];
  for (int l = bands; l < kMaxBands; ++l)
    square += band_energy(harmonics, l) * light.shadow_power[static_cast<std::size_t>(l)];
  const double e0 = std::max(light.floor_irradiance, 1e-30);
  return std::sqrt(square / (e0 * e0) + kOwnSteps * kOwnSteps);
}

Plan Governor::cheapest(const SplitLight& light, double budget) const {
  Plan best, most_accurate;
  bool found = false;
  double least_error = HUGE_VAL;
  const int most_discs = std::min<int>(limits_.most_discs, static_cast<int>(light.discs.size()));
  for (int discs = 0; discs <= most_discs; ++discs)
    for (int bands = 1; bands <= limits_.most_bands; ++bands) {
      Plan plan{bands, discs, kCalibrated * predicted_error(light, bands, discs),
                costs_.ms(bands, discs), true};
      if (plan.error < least_error) least_error = plan.error, most_accurate = plan;
      if (plan.error > budget || (found && plan.ms >= best.ms)) continue;
      best = plan;
      found = true;
    }
  if (found) return best;
  most_accurate.within_budget = false;
  return most_accurate;
}

Plan Governor::update(const SplitLight& light, TimestampNs now) {
  const Plan needed = cheapest(light, limits_.budget);
  if (!current_) return *(current_ = needed);
  const double present = kCalibrated * predicted_error(light, current_->bands, current_->discs);
  const bool too_little = present > limits_.budget && needed.error < present;
  const Plan modest = cheapest(light, kMargin * limits_.budget);
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
