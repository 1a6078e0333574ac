#include "capture/hdr/contradiction.h"

#include "core/units.h"

namespace penumbra::capture {

// Both ends rise with the code: each goes on from where it stood.
AllowedCodes allowed_codes(const CodeSamples& samples, const Exposure& known, const Exposure& asked,
                           double sigmas) {
  AllowedCodes out{};
  const auto fits = [&](unsigned code, unsigned other) {
    return !contradict(samples(code), known, samples(other), asked, samples.noise, samples.step,
                       samples.channel, sigmas);
  };
  unsigned low = 0, high = 0;
  for (unsigned code = 0; code < 256; ++code) {
    const double radiance = samples(code).signal / known.product();
    const auto same = static_cast<unsigned>(
        samples.curve.encode(samples.channel, static_cast<float>(radiance * asked.product())));
    while (low < same && !fits(code, low)) ++low;
    high = std::max(high, same);
    while (high < 255 && fits(code, high + 1)) ++high;
    out[code] = std::min(low, same) | high << 8;
  }
  return out;
}

}  // namespace penumbra::capture
