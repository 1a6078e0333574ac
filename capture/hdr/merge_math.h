// The estimator shared by the float merge and the tables.
// threads: reentrant
#pragma once

#include <span>

#include "calib/camera/noise.h"
#include "calib/camera/response_table.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Codes from here on count as clipped: 95 % of full scale.
inline constexpr double kClipLevel = .95;

/// Signal step of one code around a signal value, for the variance of quantisation; 0 for float
/// frames.
class QuantisationStep {
 public:
  QuantisationStep() = default;
  /// noise_codes: standard deviation of noise to add, where that is all that is known of it
  explicit QuantisationStep(const ResponseTable& curve, double noise_codes = 0)
      : curve_(&curve), square_codes_(1 / 12. + noise_codes * noise_codes) {}
  double variance(int channel, double signal) const {
    if (curve_ == nullptr) return 0;
    const unsigned code = curve_->encode(channel, static_cast<float>(signal));
    const unsigned last = curve_->largest_code();
    const unsigned low = code > 0 ? code - 1 : 0, high = code < last ? code + 1 : last;
    const double step =
        (curve_->decode(channel, high) - curve_->decode(channel, low)) / (high - low);
    return step * step * square_codes_;
  }

 private:
  const ResponseTable* curve_ = nullptr;
  double square_codes_ = 1 / 12.;
};

/// What a code becomes where the light on it is `factor` times as much; the largest where it is
/// clipped.
inline unsigned scaled_code(const ResponseTable& curve, double black_level, int channel,
                            unsigned code, double factor) {
  const auto linear = static_cast<double>(curve.decode(channel, code));
  if (linear + black_level >= kClipLevel) return curve.largest_code();
  return curve.encode(channel, static_cast<float>(linear * factor));
}

/// One unclipped measurement of a pixel: linear signal y of exposure e = time x gain.
struct Measurement {
  double signal;
  double product;
  double gain;
};

/// Radiance by iterated maximum likelihood; at least one measurement.
inline double estimate_radiance(std::span<const Measurement> measured,
                                const calib::NoiseModel& noise, const QuantisationStep& step,
                                int channel) {
  double signal = 0, product = 0;
  for (const Measurement& m : measured) signal += m.signal, product += m.product;
  double x = signal / product;
  if (measured.size() == 1) return x;
  for (int iteration = 0; iteration < 2; ++iteration) {
    double weighted = 0, weights = 0;
    for (const Measurement& m : measured) {
      const double expected = std::max(0., m.product * x);
      const double variance =
          noise.variance(expected, m.gain) + step.variance(channel, expected) + 1e-12;
      weighted += m.signal * m.product / variance;  // w x_k with w = e^2/var, x_k = y/e
      weights += m.product * m.product / variance;
    }
    x = weighted / weights;
  }
  return x;
}

/// Whether exposures are positive and finite.
/// errors: kInvalid naming the number
Result<void> check_exposures(std::span<const Exposure> exposures);

}  // namespace penumbra::capture
#pragma GCC visibility pop
