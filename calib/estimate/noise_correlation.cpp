#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "calib/estimate/internal/noise_correlation.h"
#include "core/median.h"

namespace penumbra::calib {

namespace {

constexpr std::size_t kParts = 64;  // of the picture, one below the other
constexpr float kMaxMeasuredLight = .95f;

// Of one pixel through time: light over its mean.
struct PixelSeries {
  std::vector<double> residual;
  double square = 0;
};

}  // namespace

NoiseCorrelation noise_correlation(const StillSeries& series, const Response& response,
                                   std::span<const double> brightness) {
  const std::vector<float> light = response.decode_table(series.bits(), 1);
  const std::size_t frames = series.frames(), pixels = series.beside()[0].size();
  const auto n = static_cast<double>(frames);
  // False where the codes tell no noise.
  const auto read = [&](PixelSeries& out, const auto& code_of) {
    double sum = 0;
    std::uint16_t lowest = 0xffff, highest = 0;
    for (std::size_t t = 0; t < frames; ++t) {
      const std::uint16_t code = code_of(t);
      lowest = std::min(lowest, code), highest = std::max(highest, code);
      out.residual[t] = static_cast<double>(light[code]) / brightness[t];
      sum += out.residual[t];
    }
    if (lowest == 0 || light[highest] > kMaxMeasuredLight || highest - lowest < 2) return false;
    out.square = 0;
    for (double& r : out.residual) r -= sum / n, out.square += r * r;
    return true;
  };
  PixelSeries here{std::vector<double>(frames)}, beside{std::vector<double>(frames)};
  std::vector<double> neighbours, successors;  // of the parts
  for (std::size_t part = 0; part < kParts; ++part) {
    const std::size_t first = part * pixels / kParts, last = (part + 1) * pixels / kParts;
    double products = 0, lags = 0;
    int count = 0;
    for (std::size_t i = first; i < last; ++i) {
      if (!read(here, [&](std::size_t t) { return series.codes()[t][3 * i + 1]; }) ||
          !read(beside, [&](std::size_t t) { return series.beside()[t][i]; }))
        continue;
      double product = 0, lag = 0;
      for (std::size_t t = 0; t < frames; ++t) product += here.residual[t] * beside.residual[t];
      for (std::size_t t = 1; t < frames; ++t) lag += here.residual[t] * here.residual[t - 1];
      products += product / std::sqrt(here.square * beside.square);
      // Noise that is independent from frame to frame gives -1 / n, since its mean is taken out.
      lags += lag / here.square + 1 / n;
      ++count;
    }
    constexpr int kFewest = 20;
    if (count < kFewest) continue;
    neighbours.push_back(products / count), successors.push_back(lags / count);
  }
  if (neighbours.empty()) return {};
  return {median(neighbours), median(successors)};
}

}  // namespace penumbra::calib
