// Whether two samples of a pixel can show the same radiance.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <optional>

#include "calib/camera/noise.h"
#include "calib/camera/response_table.h"
#include "capture/hdr/merge_math.h"
#include "core/units.h"

namespace penumbra::capture {

/// Standard deviations between two samples of the same radiance that chance explains.
/// source: Granados et al. 2010
inline constexpr double kMaxSigmas = 3.5;
/// For cameras whose noise is a guess.
inline constexpr double kMaxSigmasOfAGuess = 7;
inline constexpr double max_sigmas(bool noise_known) {
  return noise_known ? kMaxSigmas : kMaxSigmasOfAGuess;
}
/// Of the radiance: what response curve and exposure times leave wrong.
inline constexpr double kModelError = .01;

/// A sample that may be clipped, whose signal is a lower bound then, or too dark for the curve:
/// then `at_most` bounds it from above.
struct SignalSample {
  double signal;
  bool clipped;
  std::optional<double> at_most{};
};

/// Both under the hypothesis that they show one radiance, whose estimate is their sum over the sum
/// of exposures.
inline bool contradict(const SignalSample& a, const Exposure& exposure_a, const SignalSample& b,
                       const Exposure& exposure_b, const calib::NoiseModel& noise,
                       const QuantisationStep& step, int channel, double sigmas) {
  if (a.clipped && b.clipped) return false;
  const double ea = exposure_a.product(), eb = exposure_b.product();
  const double xa = a.at_most.value_or(a.signal) / ea, xb = b.at_most.value_or(b.signal) / eb;
  if ((a.clipped && xb >= xa) || (b.clipped && xa >= xb)) return false;
  if ((a.at_most && xb <= xa) || (b.at_most && xa <= xb)) return false;
  const double x = std::max(0., (xa * ea + xb * eb) / (ea + eb));
  const auto variance = [&](double e, double gain) {
    return (noise.variance(e * x, gain) + step.variance(channel, e * x)) / (e * e);
  };
  const double all = variance(ea, exposure_a.gain.value()) + variance(eb, exposure_b.gain.value()) +
                     kModelError * kModelError * x * x;
  return std::abs(xa - xb) > sigmas * std::sqrt(all);
}

/// For each 8-bit code of one exposure, the codes of another that can show the same radiance: low |
/// high << 8.
using AllowedCodes = std::array<std::uint32_t, 256>;

/// What turns codes into samples, for one channel.
struct CodeSamples {
  const ResponseTable& curve;
  const calib::NoiseModel& noise;
  QuantisationStep step;
  unsigned first_clipped;
  int channel;
  SignalSample operator()(unsigned code) const {
    return {static_cast<double>(curve.decode(channel, code)), code >= first_clipped};
  }
};
AllowedCodes allowed_codes(const CodeSamples& samples, const Exposure& known, const Exposure& asked,
                           double sigmas);

}  // namespace penumbra::capture
