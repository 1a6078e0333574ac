#include "bench/durand_filter.h"

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>
#include <vector>

namespace penumbra::bench {

namespace {

// A Gaussian around the first pixel of a picture that repeats itself, as a spectrum.
cv::Mat gaussian_spectrum(cv::Size size, double sigma_px) {
  cv::Mat kernel(size, CV_32F), out;
  double sum = 0;
  for (int y = 0; y < size.height; ++y)
    for (int x = 0; x < size.width; ++x) {
      const double dx = std::min(x, size.width - x), dy = std::min(y, size.height - y);
      const double w = std::exp(-(dx * dx + dy * dy) / (2 * sigma_px * sigma_px));
      kernel.at<float>(y, x) = static_cast<float>(w);
      sum += w;
    }
  kernel *= 1 / sum;
  cv::dft(kernel, out);
  return out;
}

void convolve(cv::Mat& picture, const cv::Mat& spectrum, int rows) {
  cv::dft(picture, picture, 0, rows);
  cv::mulSpectrums(picture, spectrum, picture, 0);
  cv::dft(picture, picture, cv::DFT_INVERSE | cv::DFT_SCALE | cv::DFT_REAL_OUTPUT, rows);
}

}  // namespace

Image<float> durand_base(const Image<float>& log10_luminance, double sigma_px,
                         double sigma_decades) {
  const int width = log10_luminance.width(), height = log10_luminance.height();
  const auto [low, high] = std::ranges::minmax(log10_luminance.pixels());
  const int border = static_cast<int>(std::ceil(2 * sigma_px));
  const cv::Size size(cv::getOptimalDFTSize(width + border),
                      cv::getOptimalDFTSize(height + border));
  const cv::Mat spectrum = gaussian_spectrum(size, sigma_px);
  const int segments = std::max(1, static_cast<int>(std::ceil((high - low) / sigma_decades)));
  const float step = (high - low) / static_cast<float>(segments);
  const auto inverse = static_cast<float>(1 / (2 * sigma_decades * sigma_decades));
  Image<float> out(width, height);
  cv::Mat weight(size, CV_32F), sum(size, CV_32F);
  for (int j = 0; j <= segments; ++j) {
    const float middle = low + static_cast<float>(j) * step;
    weight.setTo(0), sum.setTo(0);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const float v = log10_luminance.at(x, y), d = v - middle;
        const float w = std::exp(-d * d * inverse);
        weight.at<float>(y, x) = w, sum.at<float>(y, x) = w * v;
      }
    convolve(weight, spectrum, height);
    convolve(sum, spectrum, height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const float away = step > 0 ? std::abs(log10_luminance.at(x, y) - middle) / step : 0;
        if (away < 1) out.at(x, y) += (1 - away) * sum.at<float>(y, x) / weight.at<float>(y, x);
      }
  }
  return out;
}

}  // namespace penumbra::bench
