#include "codec/log/log_luv.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

namespace penumbra::codec {

namespace {

constexpr int kMaxLogLuvCode = (1 << kLogLuvBits) - 1;
constexpr float kLogLuvSteps = 128, kColourSteps = 6400;
const float kLowestStop = std::log2(kLogLuvToe);

std::uint16_t code_of(float steps) {
  const float rounded = std::min(std::max(steps + .5f, 0.f), float{kMaxLogLuvCode});
  return static_cast<std::uint16_t>(static_cast<int>(rounded));
}

// Of a positive normal number, within .00005 and exact for powers of two: its exponent and
// log2(1 + m) = m + m (1 - m) q(m) of its mantissa, with q interpolated at Chebyshev's points.
float log2_of(float v) {
  constexpr int kMantissaBits = 23, kBias = 127;
  const auto bits = std::bit_cast<std::uint32_t>(v);
  const auto exponent = static_cast<int>(bits >> kMantissaBits) - kBias;
  const auto mantissa_bits = bits & ((1u << kMantissaBits) - 1);
  const float m = std::bit_cast<float>(mantissa_bits | std::bit_cast<std::uint32_t>(1.f)) - 1;
  const float q = .4424186f + m * (-.2695780f + m * (.1505332f - m * .0448740f));
  return static_cast<float>(exponent) + m + m * (1 - m) * q;
}

float with_toe(float v) {
  constexpr float kLargest = 1e30f;                         // sums stay finite
  return kLogLuvToe + (v > 0 ? std::min(v, kLargest) : 0);  // also of a NaN
}

const std::array<float, kMaxLogLuvCode + 1>& luminances() {
  static const auto table = [] {
    std::array<float, kMaxLogLuvCode + 1> out{};
    for (int i = 0; i <= kMaxLogLuvCode; ++i)
      out[static_cast<std::size_t>(i)] =
          std::exp2(static_cast<float>(i) / kLogLuvSteps + kLowestStop);
    return out;
  }();
  return table;
}

}  // namespace

// CIE XYZ of Rec.709 primaries, ITU-R BT.709-6 and IEC 61966-2-1.
void log_luv_from_rgb(std::span<const Rgb> values, const LogLuvPlanes<std::uint16_t>& out) {
  for (std::size_t i = 0; i < values.size(); ++i) {
    const float r = with_toe(values[i].r), g = with_toe(values[i].g), b = with_toe(values[i].b);
    const float x = .4124f * r + .3576f * g + .1805f * b, y = .2126f * r + .7152f * g + .0722f * b,
                z = .0193f * r + .1192f * g + .9505f * b;
    const float to_colour = kColourSteps / (x + 15 * y + 3 * z);
    out.l[i] = code_of((log2_of(y) - kLowestStop) * kLogLuvSteps);
    out.u[i] = code_of(to_colour * 4 * x);
    out.v[i] = code_of(to_colour * 9 * y);
  }
}

void rgb_from_log_luv(const LogLuvPlanes<const std::uint16_t>& codes, std::span<Rgb> out) {
  const auto& table = luminances();
  const auto without_toe = [](float v) { return std::max(0.f, v - kLogLuvToe); };
  for (std::size_t i = 0; i < out.size(); ++i) {
    const float y = table[std::min<std::size_t>(codes.l[i], kMaxLogLuvCode)];
    const float u = static_cast<float>(codes.u[i]) / kColourSteps,
                v = std::max<float>(codes.v[i], 1) / kColourSteps;
    const float x = y * 9 * u / (4 * v), z = y * (12 - 3 * u - 20 * v) / (4 * v);
    out[i] = {without_toe(3.2406f * x - 1.5372f * y - .4986f * z),
              without_toe(-.9689f * x + 1.8758f * y + .0415f * z),
              without_toe(.0557f * x - .2040f * y + 1.0570f * z)};
  }
}

}  // namespace penumbra::codec
