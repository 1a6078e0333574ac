#include <algorithm>
#include <cmath>

#include "core/conventions.h"
#include "core/image.h"
#include "lighting/light_filter.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/projection.h"

namespace penumbra::lighting {

namespace {

constexpr double kReset = 4;        // sigma: another light
constexpr double kSurprise = 2;     // mean square innovation over the expected one: the light moves
constexpr double kNoiseDrift = .3;  // of the noise variance, per second: memory of about ten maps
constexpr double kDrift = .001;     // of the light, per root second
constexpr double kFloor = 1e-5;     // of the light: rounding
constexpr double kDark = 1e-30;     // noise variance of no light at all
constexpr Seconds kLongestStep{1};  // the noise is not measured across longer ones
constexpr int kNoiseMaps = 60;
constexpr double kPrior = 8;  // maps' worth of trust in the mean noise of all coefficients
constexpr double kMoveRate = .5, kMinMove = .1, kMaxMove = 4;

}  // namespace

void LightFilter::update(TimestampNs time, ShProjection& light) {
  const int bands = light.light.bands();
  for (const RadianceSh* part : {&light.light, &light.upper_moments})
    for (const Rgb& term : part->terms())
      if (!is_finite(term)) return repeat(light);
  const bool follows =
      known_ && bands == bands_ && light.upper_moments.bands() == bands && time >= time_;
  if (!follows) restart(light);
  const double step_s = known_ ? (time - time_).count() : 0;
  const bool new_time = !known_ || time > time_;
  time_ = time;
  if (!read(light) && follows && !new_time) return write(light);  // the same map again
  if (noise_maps_ == 0 || is_another_light(step_s)) {
    // Without knowing the noise, and in another light, the newest map is all there is.
    const bool had_noise = noise_maps_ > 0;
    for (int i = 0; i < count(); ++i) start(values_[at(i)]);
    if (had_noise && !was_reset_) maps_ = 0;
    was_reset_ = had_noise;
    move_ = 0;
    gain_ = 1;
  } else {
    was_reset_ = false;
    correct();
  }
  known_ = true;
  if (new_time) remember(step_s);
  write(light);
}

std::optional<double> LightFilter::irradiance_noise() const {
  if (noise_maps_ == 0) return std::nullopt;
  const std::array<double, 3> weights = {luminance(Rgb{1, 0, 0}), luminance(Rgb{0, 1, 0}),
                                         luminance(Rgb{0, 0, 1})};
  double square = 0;  // over the sphere, as the harmonics are orthonormal
  for (int l = 0; l < bands_; ++l)
    for (int n = coefficient_count(l); n < coefficient_count(l + 1); ++n)
      for (int c = 0; c < 3; ++c) {
        const double factor = cosine_coefficient(l) * weights[at(c)];
        square += factor * factor * values_[at(3 * n + c)].variance;
      }
  return std::sqrt(square / (4 * kPi));
}

void LightFilter::repeat(ShProjection& light) const {
  if (known_ && light.light.bands() == bands_ && light.upper_moments.bands() == bands_)
    write(light);
}

void LightFilter::restart(const ShProjection& light) {
  *this = LightFilter();
  bands_ = std::min(light.light.bands(), light.upper_moments.bands());
}

void LightFilter::start(FilteredValue& v) const {
  v.estimate = v.measured;
  v.variance = v.noise;
  v.innovation = 0;
}

bool LightFilter::read(const ShProjection& light) {
  bool differs = false;
  energy_.fill(0);
  for (int i = 0; i < count(); ++i) {
    const RadianceSh& part = i < count() / 2 ? light.light : light.upper_moments;
    FilteredValue& v = values_[at(i)];
    const float measured = part[i / 3 % coefficient_count(bands_)][i % 3];
    differs |= measured != v.measured;
    v.measured = measured;
    energy_[group(i)] += double(v.measured) * double(v.measured) / coefficient_count(bands_);
  }
  return differs;
}

void LightFilter::write(ShProjection& light) const {
  for (int i = 0; i < count(); ++i) {
    RadianceSh& part = i < count() / 2 ? light.light : light.upper_moments;
    part[i / 3 % coefficient_count(bands_)][i % 3] = static_cast<float>(values_[at(i)].estimate);
  }
}

// Predicts and compares. Both questions are asked of the light as a whole: a lamp changes all
// coefficients alike, since Y_n^2 is the same on average, and so is the noise, var(l_n) = sum w^2
// Y_n^2 var. The mean square of nearly five hundred values hardly varies by chance: 4 sigma are
// never noise. An even light shows in its mean alone, which is asked by itself.
bool LightFilter::is_another_light(double step_s) {
  double square = 0, product = 0;
  bool mean_left = false;
  for (int i = 0; i < count(); ++i) {
    FilteredValue& v = values_[at(i)];
    const double drift = kDrift * kDrift * energy_[group(i)];
    const double move = step_s > 0 ? move_ * v.noise : 0;
    v.variance += step_s * (kNoiseDrift * v.noise + drift) + move;
    const double last = v.innovation;
    v.innovation = (double(v.measured) - v.estimate) / std::sqrt(v.variance + v.noise);
    square += v.innovation * v.innovation / count();
    product += v.innovation * last / count();
    mean_left |= i / 3 % coefficient_count(bands_) == 0 && std::abs(v.innovation) > kReset;
  }
  if (mean_left || square > kReset * kReset) return true;
  // Innovations of the right gain are white. Where they keep their sign the light moves and the
  // estimate lags, so every map is given some movement; where they alternate, less.
  if (step_s > 0) move_ += kMoveRate * (move_ + kMinMove) * std::clamp(product, -1., kMaxMove);
  move_ = std::clamp(move_, 0., kMaxMove);
  surprise_ = square > kSurprise ? square : 1;
  return false;
}

void LightFilter::correct() {
  gain_ = 0;
  for (int i = 0; i < count(); ++i) {
    FilteredValue& v = values_[at(i)];
    const double expected = v.variance + v.noise,
                 gain = 1 - v.noise / (surprise_ * expected);  // variance as large as it was seen
    v.estimate += gain * (double(v.measured) - v.estimate);
    v.variance = gain * v.noise;
    gain_ += gain / count();
  }
}

// Third differences of the last four maps, divided ones where the steps differ: they are noise and
// nothing else, for a light that stands, moves evenly or gathers speed.
void LightFilter::remember(double step_s) {
  if (step_s > kLongestStep.count()) maps_ = 0;
  const std::size_t kept = std::min<std::size_t>(maps_, kMaps - 1);
  for (std::size_t k = kept; k > 0; --k) age_s_[k] = age_s_[k - 1] + step_s;
  age_s_[0] = 0;
  std::array<double, kMaps> weight{};
  double square = 0;
  for (std::size_t k = 0; k <= kept; ++k) {
    weight[k] = 1;
    for (std::size_t j = 0; j <= kept; ++j)
      if (j != k) weight[k] /= age_s_[k] - age_s_[j];
    square += weight[k] * weight[k];
  }
  const bool complete = kept + 1 == kMaps;
  const bool first = complete && noise_maps_ == 0;
  if (complete) noise_maps_ = std::min(noise_maps_ + 1, kNoiseMaps);
  std::array<double, kGroups> mean{};
  for (int i = 0; i < count(); ++i) {
    FilteredValue& v = values_[at(i)];
    for (std::size_t k = kept; k > 0; --k) v.before[k] = v.before[k - 1];
    v.before[0] = v.measured;
    if (!complete) continue;
    double difference = 0;
    for (std::size_t k = 0; k < kMaps; ++k) difference += weight[k] * double(v.before[k]);
    const double seen = difference * difference / square;
    // What is left of a step must not spoil it for long; real noise may grow by a quarter a map.
    v.own_noise +=
        ((first ? seen : std::min(seen, kReset * kReset * v.noise)) - v.own_noise) / noise_maps_;
    mean[group(i)] += v.own_noise / coefficient_count(bands_);
  }
  maps_ = kept + 1;
  if (!complete) return;
  for (int i = 0; i < count(); ++i) {
    FilteredValue& v = values_[at(i)];
    const double trusted =
        (noise_maps_ * v.own_noise + kPrior * mean[group(i)]) / (noise_maps_ + kPrior);
    v.noise = std::max({v.own_noise, trusted, kFloor * kFloor * energy_[group(i)], kDark});
    if (first) v.variance = v.noise;
  }
}

}  // namespace penumbra::lighting
