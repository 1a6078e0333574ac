#include "tools/chart/measures/luminance_error.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "core/threads/parallel.h"
#include "tools/chart/measures/picture_pairs.h"

namespace penumbra::tools {

namespace {

constexpr double kPuRange = 256;

Image<float> encoded(const Image<float>& luminance, double cd_m2) {
  Image<float> out(luminance.width(), luminance.height());
  parallel_for(0, out.height(), 8, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = 0; x < out.width(); ++x)
        out.at(x, y) = static_cast<float>(pu21(cd_m2 * luminance.at(x, y)));
  });
  return out;
}

// Weighted by a Gaussian around each pixel, borders repeated.
Image<double> local_means(const Image<double>& in) {
  constexpr int kRadius = 5;
  constexpr double kSigma = 1.5;
  double weights[2 * kRadius + 1], sum = 0;
  for (int i = -kRadius; i <= kRadius; ++i)
    sum += weights[i + kRadius] = std::exp(-i * i / (2 * kSigma * kSigma));
  const auto along = [&](const Image<double>& from, int dx, int dy) {
    Image<double> out(from.width(), from.height());
    parallel_for(0, out.height(), 8, [&](const auto& rows) {
      for (int y = rows.begin(); y < rows.end(); ++y)
        for (int x = 0; x < out.width(); ++x)
          for (int i = -kRadius; i <= kRadius; ++i)
            out.at(x, y) += weights[i + kRadius] / sum *
                            from.at(std::clamp(x + i * dx, 0, out.width() - 1),
                                    std::clamp(y + i * dy, 0, out.height() - 1));
    });
    return out;
  };
  return along(along(in, 1, 0), 0, 1);
}

Image<double> product(const Image<float>& a, const Image<float>& b) {
  Image<double> out(a.width(), a.height());
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] = double{a.pixels()[i]} * b.pixels()[i];
  return out;
}

double mean_ssim(const Image<float>& a, const Image<float>& b) {
  const Image<float> one(a.width(), a.height(), 1.f);
  const Image<double> mean_a = local_means(product(a, one)), mean_b = local_means(product(b, one)),
                      aa = local_means(product(a, a)), bb = local_means(product(b, b)),
                      ab = local_means(product(a, b));
  constexpr double c1 = (.01 * kPuRange) * (.01 * kPuRange),
                   c2 = (.03 * kPuRange) * (.03 * kPuRange);
  double sum = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    const double ma = mean_a.pixels()[i], mb = mean_b.pixels()[i];
    const double both = ab.pixels()[i] - ma * mb,
                 each = aa.pixels()[i] - ma * ma + bb.pixels()[i] - mb * mb;
    sum += (2 * ma * mb + c1) * (2 * both + c2) / ((ma * ma + mb * mb + c1) * (each + c2));
  }
  return sum / static_cast<double>(a.area());
}

double mean_square(const Image<float>& difference) {
  double sum = 0;
  for (const float d : difference.pixels()) sum += double{d} * d;
  return sum / static_cast<double>(difference.area());
}

Image<float> difference_of(const Image<float>& a, const Image<float>& b) {
  Image<float> out(a.width(), a.height());
  for (std::size_t i = 0; i < out.area(); ++i)
    out.pixels()[i] = std::abs(a.pixels()[i] - b.pixels()[i]);
  return out;
}

double ratio_db(double range, double mse) {
  if (!(mse > 0)) return HUGE_VAL;
  return range > 0 ? 10 * std::log10(range * range / mse)
                   : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

Result<LuminanceError> luminance_error(const Image<Rgb>& reference, const Image<Rgb>& test) {
  PENUMBRA_TRY(check_pair(reference, test));
  const Image<float> a = shown_luminance(reference), b = shown_luminance(test);
  const auto [low, high] = std::ranges::minmax(a.pixels());
  LuminanceError out;
  out.mse = mean_square(difference_of(a, b));
  out.psnr_db = ratio_db(double{high} - low, out.mse);
  return out;
}

double pu21(double luminance_cd_m2) {
  constexpr double p1 = .353487901, p2 = .3734658629, p3 = 8.277049286e-05, p4 = .9062562627,
                   p5 = .09150303166, p6 = .9099517204, p7 = 596.3148142;
  const double power = std::pow(std::clamp(luminance_cd_m2, .005, 10000.), p4);
  return p7 * (std::pow((p1 + p2 * power) / (1 + p3 * power), p5) - p6);
}

Result<Pu21Error> pu21_error(const Image<Rgb>& reference, const Image<Rgb>& test, double cd_m2) {
  if (!(cd_m2 > 0) || !std::isfinite(cd_m2))
    return fail(ErrorCode::kInvalid, "luminance of 1", fmt::format("{} is not above 0", cd_m2));
  PENUMBRA_TRY(check_pair(reference, test));
  const Image<float> a = encoded(shown_luminance(reference), cd_m2),
                     b = encoded(shown_luminance(test), cd_m2);
  Pu21Error out;
  out.difference = difference_of(a, b);
  out.psnr_db = ratio_db(kPuRange, mean_square(out.difference));
  out.ssim = mean_ssim(a, b);
  return out;
}

}  // namespace penumbra::tools
