#include <algorithm>
#include <array>
#include <cmath>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <limits>
#include <string>

#include "codec/internal/light_planes.h"
#include "core/conventions.h"

namespace penumbra::codec {

namespace {

constexpr int kMaxCode = (1 << kPlaneBits) - 1, kColourZero = 1 << (kPlaneBits - 1);
constexpr double kMaxStops = 28;
constexpr float kMaxLuminance = 1e30f;                 // sums and squares stay finite
constexpr float kWhiteU = .19784f, kWhiteV = .46832f;  // D65

// CIE XYZ of Rec.709 primaries, ITU-R BT.709-6 and IEC 61966-2-1; luminance exactly as elsewhere.
const glm::mat3 kXyzFromRgb(.4124f, kLuminance[0], .0193f, .3576f, kLuminance[1], .1192f, .1805f,
                            kLuminance[2], .9505f);
const glm::mat3 kRgbFromXyz(glm::inverse(glm::dmat3(kXyzFromRgb)));

std::int32_t code_of(double v) {
  return static_cast<std::int32_t>(std::clamp(std::lround(v), 0l, long{kMaxCode}));
}

std::string pixel_name(const Image<Rgb>& image, std::size_t index) {
  const auto width = static_cast<std::size_t>(image.width());
  return "pixel " + std::to_string(index % width) + ", " + std::to_string(index / width);
}

Rgb without_negatives(const Rgb& p) {
  return {std::max(0.f, p.r), std::max(0.f, p.g), std::max(0.f, p.b)};
}

// With what is below 0 cut, of the same luminance.
Rgb inside_rec709(const Rgb& p, float y) {
  const Rgb inside = without_negatives(p);
  return y / luminance(inside) * inside;
}

// Of a colour so far beyond Rec.709 that it has none, what is left of it without what is below 0.
float luminance_kept(const Rgb& p) {
  const float y = luminance(p);
  return y > 0 ? y : luminance(without_negatives(p));
}

// Stops of the brightest pixel and of the darkest that is not black.
struct LuminanceRange {
  double low = 0, high = 0;
};
Result<LuminanceRange> range_of(const Image<Rgb>& radiance) {
  float low = std::numeric_limits<float>::max(), high = 0;
  for (std::size_t i = 0; i < radiance.area(); ++i) {
    const Rgb& p = radiance.pixels()[i];
    const float y = luminance_kept(p);
    if (!is_finite(p) || !std::isfinite(y))
      return fail(ErrorCode::kNonFinite, pixel_name(radiance, i), "is not finite");
    if (y > kMaxLuminance)
      return fail(ErrorCode::kInvalid, pixel_name(radiance, i), "is brighter than 1e30");
    if (!(y > 0)) continue;
    low = std::min(low, y);
    high = std::max(high, y);
  }
  if (high == 0) return LuminanceRange{};
  const double top = std::log2(double{high});
  return LuminanceRange{std::max(std::log2(double{low}), top - kMaxStops), top};
}

}  // namespace

Result<LightPlanes> planes_from_rgb(const Image<Rgb>& radiance, double steps_per_stop) {
  PENUMBRA_ASSIGN(range, range_of(radiance));
  LightPlanes out;
  out.width = radiance.width(), out.height = radiance.height();
  out.scale.lowest_stop = static_cast<float>(range.low - kStopsAboveBlack);
  out.scale.steps_per_stop = static_cast<float>(
      std::min(steps_per_stop, (kMaxCode - 1) / (kStopsAboveBlack + range.high - range.low)));
  for (auto& plane : out.codes) plane.resize(radiance.area());
  const float colour_steps = out.scale.steps_per_stop * kColourPerStop;
  std::int32_t u = kColourZero, v = kColourZero;  // black takes its neighbour's colour: no edge
  for (std::size_t i = 0; i < radiance.area(); ++i) {
    const Rgb& p = radiance.pixels()[i];
    const double y = luminance_kept(p), stop = y > 0 ? std::log2(y) : range.low - 1;
    if (stop >= range.low) {
      const Rgb inside = inside_rec709(p, static_cast<float>(y));
      const glm::vec3 xyz = kXyzFromRgb * glm::vec3(inside.r, inside.g, inside.b);
      const float sum = xyz.x + 15 * xyz.y + 3 * xyz.z;
      u = code_of(kColourZero + colour_steps * (4 * xyz.x / sum - kWhiteU));
      v = code_of(kColourZero + colour_steps * (9 * xyz.y / sum - kWhiteV));
      out.codes[0][i] =
          code_of((stop - double{out.scale.lowest_stop}) * double{out.scale.steps_per_stop});
    }
    out.codes[1][i] = u, out.codes[2][i] = v;
  }
  return out;
}

Image<Rgb> rgb_from_planes(const LightPlanes& planes) {
  Image<Rgb> out(planes.width, planes.height);
  const double lowest = planes.scale.lowest_stop, stop_step = 1. / planes.scale.steps_per_stop;
  const float colour_step = 1 / (planes.scale.steps_per_stop * kColourPerStop);
  const double black = kStopsAboveBlack / 2 * planes.scale.steps_per_stop;
  for (std::size_t i = 0; i < out.area(); ++i) {
    const std::int32_t code = planes.codes[0][i];
    if (code < black) continue;
    const auto y = static_cast<float>(std::exp2(lowest + code * stop_step));
    const float u = kWhiteU + static_cast<float>(planes.codes[1][i] - kColourZero) * colour_step;
    const float v = std::max(
        1e-3f, kWhiteV + static_cast<float>(planes.codes[2][i] - kColourZero) * colour_step);
    const glm::vec3 rgb =
        kRgbFromXyz * glm::vec3(y * 9 * u / (4 * v), y, y * (12 - 3 * u - 20 * v) / (4 * v));
    out.pixels()[i] = inside_rec709({rgb.x, rgb.y, rgb.z}, y);
  }
  return out;
}

StillError error_of(const Image<Rgb>& truth, const Image<Rgb>& decoded, const LightScale& scale) {
  const double black = std::exp2(double{scale.lowest_stop}),
               least = black * std::exp2(kStopsAboveBlack) * (1 - 1e-6);
  double sum = 0, count = 0;
  std::array<double, 3> light{}, kept{};
  StillError out;
  out.negative = static_cast<std::size_t>(std::ranges::count_if(truth.pixels(), [](const Rgb& p) {
    return std::min({p.r, p.g, p.b}) < 0;
  }));
  const auto width = static_cast<std::size_t>(truth.width());
  const bool is_sphere = truth.width() == 2 * truth.height();
  // Of a row, for the sums of light.
  const auto weight = [&](std::size_t row) {
    return is_sphere ? std::sin(kPi * (double(row) + .5) / truth.height()) : 1;
  };
  for (std::size_t i = 0; i < truth.area(); ++i) {
    const Rgb &a = truth.pixels()[i], &b = decoded.pixels()[i];
    const double y = luminance_kept(a);
    if (!(y >= least)) continue;
    const Rgb inside = inside_rec709(a, static_cast<float>(y));
    const double part = weight(i / width);
    for (int c = 0; c < 3; ++c) {
      light[static_cast<std::size_t>(c)] += part * double{inside[c]};
      kept[static_cast<std::size_t>(c)] += part * double{b[c]};
    }
    // What became black is off by as much as the scale's end.
    const double error = std::abs(std::log10(std::max<double>(luminance(b), black) / y));
    sum += error * error;
    out.luminance_max = std::max(out.luminance_max, error);
    ++count;
  }
  if (count == 0) return out;
  out.luminance_rms = std::sqrt(sum / count);
  const double part = std::ranges::max(light) / 20;
  for (std::size_t c = 0; c < 3; ++c)
    out.light = std::max(out.light, std::abs(std::log10((kept[c] + part) / (light[c] + part))));
  return out;
}

}  // namespace penumbra::codec
