// Adaptive logarithms (Xu 2005, equations 9.8 to 9.11) as a pixel type beside half floats: bits at
// the error of a half, error at 16 bits, time to read. Docs: docs/methods/still-coding.md.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "bench/harness.h"
#include "capture/studio/environments.h"
#include "core/half.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

namespace penumbra::bench {
namespace {

// Code 0 is a value of 0, and the lowest bit the sign where there is one.
class AdaptiveLog {
 public:
  AdaptiveLog(const std::vector<float>& values, int bits, bool is_signed)
      : signed_(is_signed), steps_((1 << (bits - (is_signed ? 1 : 0))) - 2) {
    float least = 1e30f, most = 0;
    for (const float v : values)
      if (v != 0) least = std::min(least, std::abs(v)), most = std::max(most, std::abs(v));
    // A ten-thousandth of a signed whole's largest value is nothing beside it.
    if (is_signed) least = std::max(least, most * 1e-4f);
    low_ = std::log10(least), decades_ = std::log10(most) - low_;
    table_.push_back(0);
    for (int i = 0; i <= steps_; ++i) {
      const float v = std::pow(10.f, low_ + decades_ * static_cast<float>(i) / steps());
      table_.push_back(v);
      if (is_signed) table_.push_back(-v);
    }
    if (is_signed) table_.insert(table_.begin() + 1, 0.f);
  }
  std::uint16_t encode(float v) const {
    const float place = (std::log10(std::abs(v)) - low_) / decades_ * steps();
    if (v == 0 || place < -.5f) return 0;
    const int step = std::clamp(static_cast<int>(std::lround(place)), 0, steps_) + 1;
    return static_cast<std::uint16_t>(signed_ ? 2 * step + (v < 0) : step);
  }
  float decode(std::uint16_t code) const { return table_[code]; }
  float decades() const { return decades_; }

 private:
  float steps() const { return static_cast<float>(steps_); }
  bool signed_;
  int steps_;
  float low_ = 0, decades_ = 0;
  std::vector<float> table_;
};

enum class Held { kEnvironment, kTransfer, kShadow };

// What each holds, as the program makes it.
std::vector<float> values_of(Held held) {
  std::vector<float> out;
  const auto add = [&](const Image<Rgb>& image) {
    for (const Rgb& c : image.pixels()) out.insert(out.end(), {c.r, c.g, c.b});
  };
  if (held == Held::kEnvironment) {
    add(capture::make_room_environment(1024, 512));
    return out;
  }
  prt::Mesh mesh = prt::make_knot(.35f, 120, 16, {.7f, .7f, .7f});
  prt::BakeOptions options;
  options.bands = 5;
  options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0), {.4f, .4f, .4f}};
  const prt::BakedObject knot = *prt::bake(std::move(mesh), options);
  if (held == Held::kTransfer) {
    // They are halves already: times a number, they are none.
    for (const std::uint16_t bits : knot.transfer.values)
      out.push_back(1.2345f * float_from_half(bits));
    return out;
  }
  RadianceSh light(5);
  light[0] = {3, 3, 3}, light[1] = {1, 1, 1}, light[3] = {.8f, .8f, .8f};
  shadows::PlanarShadow shadow;
  (void)shadows::compose_planar_shadow(knot, light, shadow);
  add(shadow.ratio);
  return out;
}

// RMS over the RMS of the values.
double rms_error(const std::vector<float>& values, const auto& decoded) {
  double off = 0, all = 0;
  for (const float v : values) off += std::pow(decoded(v) - v, 2), all += double{v} * v;
  return std::sqrt(off / all);
}

int bits_at_error_of_half(const AdaptiveLog& any, bool is_signed) {
  const double error = std::exp2(-11);  // of a half's rounding
  return static_cast<int>(std::ceil(std::log2(any.decades() / (2 * std::log10(1 + error)) + 2))) +
         (is_signed ? 1 : 0);
}

void adaptive_log(benchmark::State& state) {
  const Threads threads(1);
  const auto held = static_cast<Held>(state.range(0));
  const bool is_signed = held == Held::kTransfer;
  const std::vector<float> values = values_of(held);
  const AdaptiveLog sixteen(values, 16, is_signed);
  const int bits = bits_at_error_of_half(sixteen, is_signed);
  const AdaptiveLog few(values, std::min(bits, 16), is_signed);
  std::vector<std::uint16_t> codes, halves;
  for (const float v : values) codes.push_back(few.encode(v)), halves.push_back(half_from_float(v));
  float sum = 0;
  compare(
      state,
      [&] {
        for (const std::uint16_t c : codes) sum += few.decode(c);
        benchmark::DoNotOptimize(sum);
      },
      [&] {
        for (const std::uint16_t h : halves) sum += float_from_half(h);
        benchmark::DoNotOptimize(sum);
      });
  state.counters["decades"] = sixteen.decades();
  state.counters["bits_at_error_of_half"] = bits;
  state.counters["rms_of_16_bits_ppm"] =
      1e6 * rms_error(values, [&](float v) { return sixteen.decode(sixteen.encode(v)); });
  state.counters["rms_of_half_ppm"] =
      1e6 * rms_error(values, [&](float v) { return float_from_half(half_from_float(v)); });
}
BENCHMARK(adaptive_log)
    ->Name("codec/adaptive_log_vs_half")
    ->ArgName("environment_transfer_shadow")
    ->Arg(0)
    ->Arg(1)
    ->Arg(2)
    ->Iterations(kRepeats)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra::bench
