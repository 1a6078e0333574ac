#include "codec/tone/internal/gaussian.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/threads/parallel.h"

namespace penumbra::tone {

namespace {

std::vector<float> gaussian_weights(double sigma_px) {
  const int radius = static_cast<int>(std::ceil(3 * sigma_px));
  std::vector<double> weights;
  double sum = 0;
  for (int i = -radius; i <= radius; ++i) {
    weights.push_back(std::exp(-i * i / (2 * sigma_px * sigma_px)));
    sum += weights.back();
  }
  std::vector<float> out;
  for (const double w : weights) out.push_back(static_cast<float>(w / sum));
  return out;
}

void blur_rows(const Image<float>& in, const std::vector<float>& weights, Image<float>& out) {
  const std::size_t radius = weights.size() / 2, width = static_cast<std::size_t>(in.width());
  parallel_for(0, in.height(), 16, [&](const auto& rows) {
    std::vector<float> padded(width + 2 * radius);
    for (int y = rows.begin(); y < rows.end(); ++y) {
      const auto source = in.row(y);
      const auto target = out.row(y);
      std::fill_n(padded.begin(), radius, source.front());
      std::ranges::copy(source, padded.begin() + static_cast<std::ptrdiff_t>(radius));
      std::fill_n(padded.end() - static_cast<std::ptrdiff_t>(radius), radius, source.back());
      std::ranges::fill(target, 0.f);
      for (std::size_t k = 0; k < weights.size(); ++k)
        for (std::size_t x = 0; x < width; ++x) target[x] += weights[k] * padded[x + k];
    }
  });
}

void blur_columns(const Image<float>& in, const std::vector<float>& weights, Image<float>& out) {
  const int radius = static_cast<int>(weights.size() / 2);
  parallel_for(0, in.height(), 16, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y) {
      const auto target = out.row(y);
      std::ranges::fill(target, 0.f);
      for (int k = -radius; k <= radius; ++k) {
        const auto source = in.row(std::clamp(y + k, 0, in.height() - 1));
        const float weight = weights[static_cast<std::size_t>(k + radius)];
        for (std::size_t x = 0; x < target.size(); ++x) target[x] += weight * source[x];
      }
    }
  });
}

}  // namespace

Image<float> gaussian_blur(const Image<float>& in, double sigma_px) {
  if (!(sigma_px > 0) || in.empty()) return in;
  const std::vector<float> weights = gaussian_weights(sigma_px);
  Image<float> across(in.width(), in.height()), out(in.width(), in.height());
  blur_rows(in, weights, across);
  blur_columns(across, weights, out);
  return out;
}

}  // namespace penumbra::tone
