#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numbers>
#include <string>
#include <string_view>
#include <vector>

#include "codec/tone/internal/checks.h"
#include "codec/tone/internal/luminance.h"
#include "codec/tone/internal/row_kernel.h"
#include "codec/tone/tone_mapping.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::tone {

namespace {

// Counts of luminances by the upper bits of their floats: bins half a percent wide, in order.
constexpr int kBinShift = 16;
constexpr std::size_t kBins = std::size_t{1} << (31 - kBinShift);

struct PartCount {
  std::vector<std::uint32_t> bins = std::vector<std::uint32_t>(kBins);
  double sum = 0;  // of logarithms
  std::size_t lit = 0, negative = 0;
  int bad_x = -1, bad_y = -1;
};

void count_row(const Image<Rgb>& radiance, int y, std::vector<float>& logs, PartCount& out) {
  logs.clear();
  for (int x = 0; x < radiance.width(); ++x) {
    const Rgb& p = radiance.at(x, y);
    if (!is_finite(p)) {
      if (out.bad_x < 0) out.bad_x = x, out.bad_y = y;
      return;
    }
    if (p.r < 0 || p.g < 0 || p.b < 0) ++out.negative;
    const float l = luminance_of(p);
    if (!(l >= std::numeric_limits<float>::min())) continue;
    ++out.bins[std::bit_cast<std::uint32_t>(l) >> kBinShift];
    logs.push_back(l);
  }
  log_in_place(logs);
  double sum = 0;
  for (const float l : logs) sum += l;
  out.sum += sum;
  out.lit += logs.size();
}

double bin_edge(std::size_t bin) {
  const float edge = std::bit_cast<float>(static_cast<std::uint32_t>(bin << kBinShift));
  return std::log(std::isfinite(edge) ? edge : std::numeric_limits<float>::max());
}

// The logarithm below which a fraction of the counted lies, even within a bin.
double quantile(const std::vector<std::uint32_t>& bins, std::size_t total, double fraction) {
  const double wanted = fraction * static_cast<double>(total);
  double below = 0;
  std::size_t last = 0;
  for (std::size_t bin = 0; bin < bins.size(); ++bin) {
    if (bins[bin] == 0) continue;
    const double here = bins[bin];
    last = bin;
    if (below + here >= wanted) {
      const double low = bin_edge(bin), high = bin_edge(bin + 1);
      return low + (high - low) * std::clamp((wanted - below) / here, 0., 1.);
    }
    below += here;
  }
  return bin_edge(last + 1);
}

}  // namespace

double ToneStatistics::range() const {
  return std::max(high - low, std::numbers::ln10);
}

Result<void> check_option(std::string_view name, double value, double lowest, double highest) {
  if (value >= lowest && value <= highest) return {};
  return fail(ErrorCode::kInvalid, std::string(name),
              fmt::format("{} is not between {} and {}", value, lowest, highest));
}

Result<void> check_finite_values(const Image<float>& values, std::string_view name) {
  for (int y = 0; y < values.height(); ++y)
    for (int x = 0; x < values.width(); ++x)
      if (!std::isfinite(values.at(x, y)))
        return fail(ErrorCode::kNonFinite, std::string(name),
                    fmt::format("pixel ({}, {}) is not finite", x, y));
  return {};
}

Result<ToneStatistics> measure_tone(const Image<Rgb>& radiance) {
  if (radiance.empty()) return fail(ErrorCode::kInvalid, "picture", "has no pixels");
  constexpr int kParts = 8;  // fixed, so that sums are the same on any number of cores
  std::array<PartCount, kParts> parts;
  parallel_for(0, kParts, [&](int part) {
    std::vector<float> logs;
    const auto row = [&](int k) {
      return static_cast<int>(std::int64_t{radiance.height()} * k / kParts);
    };
    for (int y = row(part); y < row(part + 1); ++y)
      count_row(radiance, y, logs, parts[static_cast<std::size_t>(part)]);
  });
  PartCount all;
  for (const PartCount& part : parts) {
    if (part.bad_x >= 0)
      return fail(ErrorCode::kNonFinite, "picture",
                  fmt::format("pixel ({}, {}) is not finite", part.bad_x, part.bad_y));
    for (std::size_t bin = 0; bin < kBins; ++bin) all.bins[bin] += part.bins[bin];
    all.sum += part.sum, all.lit += part.lit, all.negative += part.negative;
  }
  ToneStatistics out;
  out.negative = all.negative;
  out.black = all.lit == 0;
  if (out.black) return out;
  constexpr double kTail = .001;
  out.mean = all.sum / static_cast<double>(all.lit);
  out.median = quantile(all.bins, all.lit, .5);
  out.low = quantile(all.bins, all.lit, kTail);
  out.high = quantile(all.bins, all.lit, 1 - kTail);
  return out;
}

}  // namespace penumbra::tone
