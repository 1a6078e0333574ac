#include "tools/chart/measures/sarnoff.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <vector>

#include "core/median.h"
#include "tools/chart/measures/picture_pairs.h"

namespace penumbra::tools {

namespace {

// Mirrored about the border pixel, so that alternating lines go on alternating.
int mirrored(int i, int count) {
  if (count == 1) return 0;
  const int period = 2 * (count - 1), k = std::abs(i) % period;
  return k < count ? k : period - k;
}

// Every second pixel of the picture smoothed by 1 4 6 4 1 (Burt & Adelson 1983).
Image<float> reduced(const Image<float>& in) {
  constexpr float kWeights[] = {1.f / 16, 4.f / 16, 6.f / 16, 4.f / 16, 1.f / 16};
  Image<float> across((in.width() + 1) / 2, in.height());
  for (int y = 0; y < across.height(); ++y)
    for (int x = 0; x < across.width(); ++x)
      for (int k = 0; k < 5; ++k)
        across.at(x, y) += kWeights[k] * in.at(mirrored(2 * x + k - 2, in.width()), y);
  Image<float> out(across.width(), (in.height() + 1) / 2);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x)
      for (int k = 0; k < 5; ++k)
        out.at(x, y) += kWeights[k] * across.at(x, mirrored(2 * y + k - 2, in.height()));
  return out;
}

// A sample of a line twice as fine: the same weights, those that meet a sample.
template <class Sample>
float expanded(int i, const Sample& sample) {
  if (i % 2) return .5f * (sample(i / 2) + sample(i / 2 + 1));
  return .125f * (sample(i / 2 - 1) + 6 * sample(i / 2) + sample(i / 2 + 1));
}

Image<float> enlarged(const Image<float>& in, int width, int height) {
  Image<float> across(width, in.height()), out(width, height);
  for (int y = 0; y < in.height(); ++y)
    for (int x = 0; x < width; ++x)
      across.at(x, y) = expanded(x, [&](int i) { return in.at(mirrored(i, in.width()), y); });
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      out.at(x, y) = expanded(y, [&](int i) { return across.at(x, mirrored(i, in.height())); });
  return out;
}

// Equation 3.3: of the ratio to the middle, 0..1.
float s_curve(float ratio, float exponent) {
  const float power = std::pow(std::min(ratio, 1e15f), exponent);
  return power / (1 + power);
}

Image<float> normalised(const Image<float>& luminance, float half) {
  constexpr float kExponent = .73f;
  Image<float> out(luminance.width(), luminance.height());
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] = s_curve(luminance.pixels()[i] / half, kExponent);
  return out;
}

// 1/2 where there is none.
Image<float> contrast(const Image<float>& fine, const Image<float>& coarse) {
  constexpr float kNothing = 1e-4f;  // black on black has no contrast
  const Image<float> around = enlarged(coarse, fine.width(), fine.height());
  Image<float> out(fine.width(), fine.height());
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] = s_curve((fine.pixels()[i] + kNothing) / (around.pixels()[i] + kNothing), 1);
  return out;
}

}  // namespace

std::array<double, kSarnoffScales> sarnoff_weights() {
  constexpr int kQuantiser[8][8] = {
      {16, 11, 10, 16, 24, 40, 51, 61},     {12, 12, 14, 19, 26, 58, 60, 55},
      {14, 13, 16, 24, 40, 57, 69, 56},     {14, 17, 22, 29, 51, 87, 80, 62},
      {18, 22, 37, 56, 68, 109, 103, 77},   {24, 35, 55, 64, 81, 104, 113, 92},
      {49, 64, 78, 87, 103, 121, 120, 101}, {72, 92, 95, 98, 112, 100, 103, 99}};
  constexpr double kFinest = 10;
  std::array<double, kSarnoffScales> out{};
  for (int k = 0; k < kSarnoffScales; ++k) {
    const int first = 4 >> k;  // of the octave, half cycles a block
    double sum = 0;
    int count = 0;
    for (int v = 0; v < 2 * first; ++v)
      for (int u = 0; u < 2 * first; ++u)
        if (std::max(u, v) >= first) sum += kFinest / kQuantiser[v][u], ++count;
    out[static_cast<std::size_t>(k)] = sum / count;
  }
  return out;
}

Result<Image<float>> sarnoff_map(const Image<Rgb>& reference, const Image<Rgb>& test) {
  PENUMBRA_TRY(check_pair(reference, test));
  Image<float> a = shown_luminance(reference), b = shown_luminance(test);
  std::vector<double> lit;
  for (const float l : a.pixels())
    if (l > 0) lit.push_back(l);
  if (lit.empty())
    return fail(ErrorCode::kUndetermined, "reference picture", "is black, so it has no contrast");
  const auto half = static_cast<float>(penumbra::median(lit) / .18);
  a = normalised(a, half), b = normalised(b, half);
  const auto weights = sarnoff_weights();
  Image<float> out(a.width(), a.height());
  for (int k = 0; k < kSarnoffScales; ++k) {
    Image<float> coarse_a = reduced(a), coarse_b = reduced(b);
    const Image<float> of_a = contrast(a, coarse_a), of_b = contrast(b, coarse_b);
    const auto weight = static_cast<float>(weights[static_cast<std::size_t>(k)]);
    for (int y = 0; y < out.height(); ++y)
      for (int x = 0; x < out.width(); ++x) {
        const float d = weight * (of_a.at(x >> k, y >> k) - of_b.at(x >> k, y >> k));
        out.at(x, y) += d * d;
      }
    a = std::move(coarse_a), b = std::move(coarse_b);
  }
  for (float& v : out.pixels()) v = std::sqrt(v);
  return out;
}

double mean_sarnoff(const Image<float>& map) {
  double sum = 0;
  for (const float v : map.pixels()) sum += v;
  return map.empty() ? 0 : sum / static_cast<double>(map.area());
}

}  // namespace penumbra::tools
