#include <algorithm>
#include <cmath>
#include <cstddef>

#include "codec/tone/internal/checks.h"
#include "codec/tone/internal/gaussian.h"
#include "codec/tone/tone_mapping.h"
#include "core/threads/parallel.h"

namespace penumbra::tone {

namespace {

// Scales of the paper: eight centres, each surround is the next one's centre.
constexpr int kScales = 8;
constexpr double kScaleRatio = 1.6;
constexpr double kFirstSigma = .25;  // 1 / (2 sqrt 2) of scale 1, over sqrt 2
constexpr double kKeyOfSharpness = .18;
constexpr float kEven = .05f;  // the contrast up to which surroundings count as even

// The average around each pixel over the largest surroundings without a strong contrast: equations
// 5 to 8. A blurred picture lives only as long as the scale that needs it.
Image<float> adapted(const Image<float>& luminance, double sharpness) {
  Image<float> out = gaussian_blur(luminance, kFirstSigma), centre = out;
  std::vector<unsigned char> done(luminance.area());
  double sigma = kFirstSigma, scale = 1;
  for (int k = 0; k < kScales; ++k) {
    const double next = sigma * kScaleRatio;
    const Image<float> surround = gaussian_blur(centre, std::sqrt(next * next - sigma * sigma));
    const float bias = static_cast<float>(std::exp2(sharpness) * kKeyOfSharpness / (scale * scale));
    parallel_for(std::size_t{0}, luminance.area(), std::size_t{1} << 14, [&](const auto& part) {
      for (std::size_t i = part.begin(); i < part.end(); ++i) {
        if (done[i]) continue;
        const float c = centre.pixels()[i];
        if (std::abs(c - surround.pixels()[i]) >= kEven * (bias + c))
          done[i] = 1;
        else
          out.pixels()[i] = c;
      }
    });
    centre = surround;
    sigma = next, scale *= kScaleRatio;
  }
  return out;
}

// Constants of Hable's curve: shoulder, linear part and toe.
double film(double x) {
  constexpr double a = .15, b = .5, c = .1, d = .2, e = .02, f = .3;
  return (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f;
}

}  // namespace

Result<Image<float>> photographic(const Image<float>& luminance, double white, bool local,
                                  double sharpness) {
  PENUMBRA_TRY(check_option("white", white, 1e-3, 1e12));
  PENUMBRA_TRY(check_option("sharpness", sharpness, 0, 64));
  PENUMBRA_TRY(check_finite_values(luminance, "luminance"));
  if (luminance.empty()) return luminance;
  Image<float> out = local ? adapted(luminance, sharpness) : luminance;
  const float burn = static_cast<float>(1 / (white * white));
  parallel_for(std::size_t{0}, out.area(), std::size_t{1} << 14, [&](const auto& part) {
    for (std::size_t i = part.begin(); i < part.end(); ++i) {
      constexpr float kLong = 1e15f;  // far above any white, and its square is finite
      const float l = std::min(luminance.pixels()[i], kLong);
      const float shown = l * (1 + l * burn) / (1 + std::min(out.pixels()[i], kLong));
      out.pixels()[i] = std::min(shown, 1.f);
    }
  });
  return out;
}

float filmic_curve(float exposed, float white) {
  constexpr double kLong = 1e6;
  const double shown = film(std::min<double>(exposed, kLong)) / film(white);
  return static_cast<float>(std::clamp(shown, 0., 1.));
}

Image<Rgb> filmic_exposure(const Image<Rgb>& radiance, double factor, double white) {
  Image<Rgb> out(radiance.width(), radiance.height());
  parallel_for(0, radiance.height(), 8, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y)
      for (int x = 0; x < radiance.width(); ++x)
        for (int c = 0; c < 3; ++c)
          out.at(x, y)[c] =
              filmic_curve(static_cast<float>(factor * std::max(0.f, radiance.at(x, y)[c])),
                           static_cast<float>(white));
  });
  return out;
}

}  // namespace penumbra::tone
