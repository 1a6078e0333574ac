#include <algorithm>
#include <array>
#include <cmath>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec3.hpp>
#include <limits>
#include <span>
#include <string>
#include <utility>

#include "codec/internal/light_planes.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::codec {

const glm::mat3 kXyzFromRgb(.4124f, kLuminance[0], .0193f, .3576f, kLuminance[1], .1192f, .1805f,
                            kLuminance[2], .9505f);
const glm::mat3 kRgbFromXyz(glm::inverse(glm::dmat3(kXyzFromRgb)));

namespace {

constexpr int kMaxCode = (1 << kPlaneBits) - 1, kColourZero = 1 << (kPlaneBits - 1);
constexpr double kMaxStops = 28;
constexpr int kRowsAtOnce = 16;
constexpr float kMaxLuminance = 1e30f;                 // sums and squares stay finite
constexpr float kWhiteU = .19784f, kWhiteV = .46832f;  // D65

std::int32_t plane_code(float v) {
  return static_cast<std::int32_t>(std::clamp(v + .5f, 0.f, float{kMaxCode}));
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

struct RowCodes {
  std::span<std::int32_t> luminance, u, v;
};

// Black, which has none, takes the colour of what is lit before it in its row, or first: no edge.
void fill_codes(std::span<const Rgb> row, const LightScale& scale, double darkest,
                const RowCodes& out) {
  constexpr float kRounding = 1e-6f;
  const float colour_steps = scale.steps_per_stop * kColourPerStop;
  std::int32_t u = kColourZero, v = kColourZero;
  bool is_first = true;
  for (std::size_t x = 0; x < row.size(); ++x) {
    const float y = luminance_kept(row[x]), above = static_cast<float>(double{y} / darkest);
    if (above >= 1 - kRounding) {
      const Rgb inside = inside_rec709(row[x], y);
      const glm::vec3 xyz = kXyzFromRgb * glm::vec3(inside.r, inside.g, inside.b);
      const float sum = xyz.x + 15 * xyz.y + 3 * xyz.z;
      u = plane_code(kColourZero + colour_steps * (4 * xyz.x / sum - kWhiteU));
      v = plane_code(kColourZero + colour_steps * (9 * xyz.y / sum - kWhiteV));
      out.luminance[x] = plane_code((std::log2(above) + kStopsAboveBlack) * scale.steps_per_stop);
      if (std::exchange(is_first, false)) {
        std::ranges::fill(out.u.first(x), u);
        std::ranges::fill(out.v.first(x), v);
      }
    }
    out.u[x] = u, out.v[x] = v;
  }
}

}  // namespace

Rgb inside_rec709(const Rgb& p) {
  const float y = luminance_kept(p);
  return y > 0 ? inside_rec709(p, y) : Rgb{};
}

Result<void> check_light(const Image<Rgb>& radiance) {
  PENUMBRA_TRY(range_of(radiance));
  return {};
}

Result<LightPlanes> planes_from_rgb(const Image<Rgb>& radiance, double steps_per_stop) {
  PENUMBRA_ASSIGN(range, range_of(radiance));
  LightPlanes out;
  out.width = radiance.width(), out.height = radiance.height();
  out.scale.lowest_stop = static_cast<float>(range.low - kStopsAboveBlack);
  out.scale.steps_per_stop = static_cast<float>(
      std::min(steps_per_stop, (kMaxCode - 1) / (kStopsAboveBlack + range.high - range.low)));
  for (auto& plane : out.codes) plane.resize(radiance.area());
  const double darkest = std::exp2(range.low);
  parallel_for(0, out.height, kRowsAtOnce, [&](const Indices<int>& rows) {
    const auto width = static_cast<std::size_t>(out.width);
    for (int y = rows.begin(); y < rows.end(); ++y) {
      const auto row = [&](std::vector<std::int32_t>& plane) {
        return std::span(plane).subspan(static_cast<std::size_t>(y) * width, width);
      };
      fill_codes(radiance.row(y), out.scale, darkest,
                 {row(out.codes[0]), row(out.codes[1]), row(out.codes[2])});
    }
  });
  return out;
}

Image<Rgb> rgb_from_planes(const LightPlanes& planes) {
  Image<Rgb> out(planes.width, planes.height);
  const float lowest = planes.scale.lowest_stop, stop_step = 1 / planes.scale.steps_per_stop,
              colour_step = 1 / (planes.scale.steps_per_stop * kColourPerStop);
  const double black = kStopsAboveBlack / 2 * planes.scale.steps_per_stop;
  parallel_for(0, planes.height, kRowsAtOnce, [&](const Indices<int>& rows) {
    const auto width = static_cast<std::size_t>(planes.width);
    for (std::size_t i = static_cast<std::size_t>(rows.begin()) * width;
         i < static_cast<std::size_t>(rows.end()) * width; ++i) {
      const std::int32_t code = planes.codes[0][i];
      if (code < black) continue;
      const float y = std::exp2(lowest + static_cast<float>(code) * stop_step);
      const float u = kWhiteU + static_cast<float>(planes.codes[1][i] - kColourZero) * colour_step;
      const float v = std::max(
          1e-3f, kWhiteV + static_cast<float>(planes.codes[2][i] - kColourZero) * colour_step);
      const glm::vec3 rgb =
          kRgbFromXyz * glm::vec3(y * 9 * u / (4 * v), y, y * (12 - 3 * u - 20 * v) / (4 * v));
      out.pixels()[i] = inside_rec709({rgb.x, rgb.y, rgb.z}, y);
    }
  });
  return out;
}

namespace {

// Sums over a row's pixels that the scale holds.
struct RowError {
  double squares = 0, largest = 0;      // of log10 luminance
  glm::dvec3 light{0}, kept{0};         // of the truth, of what was decoded
  std::size_t count = 0, negative = 0;  // the latter of all pixels
};

RowError error_of_row(std::span<const Rgb> truth, std::span<const Rgb> decoded, double least,
                      double black) {
  RowError out;
  for (std::size_t x = 0; x < truth.size(); ++x) {
    const Rgb &a = truth[x], &b = decoded[x];
    out.negative += std::min({a.r, a.g, a.b}) < 0;
    const float y = luminance_kept(a);
    if (!(double{y} >= least)) continue;
    const Rgb inside = inside_rec709(a, y);
    out.light += glm::dvec3(inside.r, inside.g, inside.b);
    out.kept += glm::dvec3(b.r, b.g, b.b);
    // What became black is off by as much as the scale's end.
    const double error = std::abs(std::log10(std::max<double>(luminance(b), black) / double{y}));
    out.squares += error * error;
    out.largest = std::max(out.largest, error);
    ++out.count;
  }
  return out;
}

}  // namespace

StillError error_of(const Image<Rgb>& truth, const Image<Rgb>& decoded, const LightScale& scale) {
  const double black = std::exp2(double{scale.lowest_stop}),
               least = black * std::exp2(kStopsAboveBlack) * (1 - 1e-6);
  std::vector<RowError> rows(static_cast<std::size_t>(truth.height()));
  parallel_for(0, truth.height(), kRowsAtOnce, [&](const Indices<int>& part) {
    for (int y = part.begin(); y < part.end(); ++y)
      rows[static_cast<std::size_t>(y)] = error_of_row(truth.row(y), decoded.row(y), least, black);
  });
  const bool is_sphere = truth.width() == 2 * truth.height();
  RowError all;
  for (std::size_t y = 0; y < rows.size(); ++y) {
    const RowError& row = rows[y];
    const double weight = is_sphere ? std::sin(kPi * (double(y) + .5) / truth.height()) : 1;
    all.light += weight * row.light, all.kept += weight * row.kept;
    all.squares += row.squares, all.count += row.count, all.negative += row.negative;
    all.largest = std::max(all.largest, row.largest);
  }
  StillError out{.luminance_max = all.largest, .negative = all.negative};
  if (all.count == 0) return out;
  out.luminance_rms = std::sqrt(all.squares / static_cast<double>(all.count));
  const double part = std::max({all.light.x, all.light.y, all.light.z}) / 20;
  for (int c = 0; c < 3; ++c)
    out.light =
        std::max(out.light, std::abs(std::log10((all.kept[c] + part) / (all.light[c] + part))));
  return out;
}

}  // namespace penumbra::codec
