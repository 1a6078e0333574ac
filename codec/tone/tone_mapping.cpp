#include "codec/tone/tone_mapping.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "codec/display.h"
#include "codec/tone/internal/checks.h"
#include "codec/tone/internal/luminance.h"
#include "codec/tone/internal/row_kernel.h"
#include "core/conventions.h"
#include "core/threads/parallel.h"

namespace penumbra::tone {

namespace {

struct NamedOperator {
  std::string_view name;
  ToneOperator op;
};
constexpr std::array kOperators{
    NamedOperator{"level-set", ToneOperator::kLevelSet},
    NamedOperator{"photographic", ToneOperator::kPhotographic},
    NamedOperator{"photographic-local", ToneOperator::kPhotographicLocal},
    NamedOperator{"bilateral", ToneOperator::kBilateral},
    NamedOperator{"filmic", ToneOperator::kFilmic}};
constexpr double kMiddleGrey = .18;

template <class Body>
void for_rows(const auto& picture, const Body& body) {
  parallel_for(0, picture.height(), 8, [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y) body(y);
  });
}

Result<void> check_options(const ToneOptions& o) {
  PENUMBRA_TRY(check_option("exposure", o.exposure_stops, -32, 32));
  PENUMBRA_TRY(check_option("key", o.key.value_or(kMiddleGrey), .01, .9));
  PENUMBRA_TRY(check_option("saturation", o.saturation, 0, 2));
  PENUMBRA_TRY(check_option("contrast", o.contrast, .1, 4));
  PENUMBRA_TRY(check_option("white", o.white.value_or(2), 1, 1e6));
  PENUMBRA_TRY(check_option("bilateral fraction", o.bilateral_fraction, .001, .5));
  PENUMBRA_TRY(check_option("bilateral decades", o.bilateral_decades, .01, 4));
  return check_option("base decades", o.base_decades, .1, 8);
}

// A picture whose middle lies near its bright end is a bright scene: Reinhard 2002, "Parameter
// estimation for photographic tone reproduction". Here by one stop at most, not by two: a lamp in
// an even room would make it a night.
double key_of(const ToneOptions& o, const ToneStatistics& s) {
  if (o.key) return *o.key;
  if (!(s.high > s.low)) return kMiddleGrey;
  const double place = std::clamp((2 * s.mean - s.low - s.high) / (s.high - s.low), -1., 1.);
  return kMiddleGrey * std::exp2(place);
}

// Nothing counts as darker than the darkest thousandth: no light has no logarithm.
float darkest(const ToneStatistics& s) {
  return static_cast<float>(std::exp(s.low));
}

Image<float> log_luminance(const Image<Rgb>& radiance, float floor) {
  Image<float> out(radiance.width(), radiance.height());
  for_rows(radiance, [&](int y) {
    const auto in = radiance.row(y);
    const auto row = out.row(y);
    for (std::size_t x = 0; x < row.size(); ++x) row[x] = std::max(luminance_of(in[x]), floor);
    log_in_place(row);
  });
  return out;
}

// base becomes the luminance shown and the result the detail: `compress` makes the logarithm of the
// one of the row of the other.
template <class Compress>
Image<float> compress_base(Image<float> log, Image<float>& base, const Compress& compress) {
  for_rows(log, [&](int y) {
    const auto whole = log.row(y), row = base.row(y);
    for (std::size_t x = 0; x < row.size(); ++x) whole[x] -= row[x];
    compress(row);
    for (std::size_t x = 0; x < row.size(); ++x) row[x] += std::min(whole[x], 40.f);
    for (float& v : row) v = std::clamp(v, -80.f, 40.f);
    exp_in_place(row);
  });
  return log;
}

struct ShownLight {
  Image<float> luminance;  // of the display, 0..1 and above
  Image<float> detail;
};

// Equation 3.3 on the profile, whose semi-saturation is the median over .18 of the text.
Result<ShownLight> show_level_set(const Image<Rgb>& radiance, const ToneOptions& o,
                                  const ToneStatistics& s) {
  Image<float> log = log_luminance(radiance, darkest(s));
  PENUMBRA_ASSIGN(base, level_set_profile(log, s.range(), o.level_set));
  const double half =
      s.median - std::log(o.key.value_or(kMiddleGrey)) - o.exposure_stops * std::numbers::ln2;
  const auto n = static_cast<float>(o.contrast), start = static_cast<float>(n * half);
  Image<float> detail = compress_base(std::move(log), base, [&](std::span<float> row) {
    // log(I^n / (I^n + sigma^n)) = -log(1 + exp(n (log sigma - log I)))
    for (float& v : row) v = std::clamp(start - n * v, -80.f, 80.f);
    exp_in_place(row);
    for (float& v : row) v += 1;
    log_in_place(row);
    for (float& v : row) v = -v;
  });
  return ShownLight{std::move(base), std::move(detail)};
}

Result<ShownLight> show_bilateral(const Image<Rgb>& radiance, const ToneOptions& o,
                                  const ToneStatistics& s) {
  Image<float> log = log_luminance(radiance, darkest(s));
  const double side = std::max(radiance.width(), radiance.height());
  PENUMBRA_ASSIGN(base, bilateral_base(log, {std::max(4., o.bilateral_fraction * side),
                                             o.bilateral_decades * std::numbers::ln10}));
  // Never stretched: an even picture stays even.
  const double wanted = o.base_decades * std::numbers::ln10, range = s.high - s.low;
  const auto factor = static_cast<float>(range > wanted ? wanted / range : 1.);
  // The brightest is white, unless that would show an even picture's middle brighter than its key.
  const auto end = static_cast<float>(std::max(s.high, s.mean - std::log(key_of(o, s)) / factor)),
             shift = static_cast<float>(o.exposure_stops * std::numbers::ln2);
  Image<float> detail = compress_base(std::move(log), base, [&](std::span<float> row) {
    for (float& v : row) v = factor * (v - end) + shift;
  });
  return ShownLight{std::move(base), std::move(detail)};
}

// In units in which the scene's middle, its mean logarithm, is `key`.
double exposure_of(const ToneOptions& o, const ToneStatistics& s, double key) {
  return key * std::exp2(o.exposure_stops) * std::exp(-s.mean);
}

Result<ShownLight> show_photographic(const Image<Rgb>& radiance, const ToneOptions& o,
                                     const ToneStatistics& s) {
  const double key = key_of(o, s), factor = exposure_of(o, s, key);
  // A picture without light above 1 is shown as it is: white at 1 makes the curve a straight line.
  const double white = o.white ? *o.white * key : std::max(factor * std::exp(s.high), 1.);
  Image<float> luminance(radiance.width(), radiance.height());
  for_rows(radiance, [&](int y) {
    for (int x = 0; x < radiance.width(); ++x)
      luminance.at(x, y) =
          static_cast<float>(std::min(factor * luminance_of(radiance.at(x, y)), 1e30));
  });
  PENUMBRA_ASSIGN(shown, photographic(luminance, std::clamp(white, 1e-3, 1e12),
                                      o.op == ToneOperator::kPhotographicLocal, o.sharpness));
  return ShownLight{std::move(shown), {}};
}

// A colour of luminance y; where the display cannot show it, with as much white as it needs.
Rgb within_display(Rgb c, float y) {
  const float largest = std::max({c.r, c.g, c.b});
  if (largest <= 1) return c;
  if (y >= 1) return {1, 1, 1};
  const float part = (1 - y) / (largest - y);
  return {y + part * (c.r - y), y + part * (c.g - y), y + part * (c.b - y)};
}

Rgb8 code_of(const Rgb& c) {
  return {codec::srgb_code(c.r), codec::srgb_code(c.g), codec::srgb_code(c.b)};
}

// The picture's colours at the luminance shown. `floor`: what darker pixels were taken for, so that
// they are as much darker now.
Image<Rgb8> colour(const Image<Rgb>& radiance, const Image<float>& shown, float floor,
                   double saturation) {
  Image<Rgb8> out(radiance.width(), radiance.height());
  const auto part = static_cast<float>(saturation);
  for_rows(radiance, [&](int y) {
    for (int x = 0; x < radiance.width(); ++x) {
      const Rgb c = without_negative(radiance.at(x, y));
      const float l = luminance_of(c), scaled = shown.at(x, y) * std::min(1.f, l / floor);
      if (!(l > 0) || !(scaled > 0)) {
        out.at(x, y) = Rgb8{};
        continue;
      }
      const Rgb ratio = {c.r / l, c.g / l, c.b / l}, grey = {1, 1, 1};
      const Rgb kept = without_negative(grey + part * (ratio - grey));
      out.at(x, y) = code_of(within_display(scaled * kept, scaled));
    }
  });
  return out;
}

Image<Rgb8> show_film(const Image<Rgb>& radiance, const ToneOptions& o, const ToneStatistics& s) {
  // What the middle is exposed as before the curve, so that the curve shows it as the key.
  constexpr double kExposedAsKey = 2.9;
  const double factor = kExposedAsKey * exposure_of(o, s, key_of(o, s));
  const Image<Rgb> shown = filmic_exposure(radiance, factor, o.white.value_or(11.2));
  Image<Rgb8> out(radiance.width(), radiance.height());
  for_rows(radiance, [&](int y) {
    for (int x = 0; x < out.width(); ++x) out.at(x, y) = code_of(shown.at(x, y));
  });
  return out;
}

Result<ShownLight> show(const Image<Rgb>& radiance, const ToneOptions& o, const ToneStatistics& s) {
  switch (o.op) {
    case ToneOperator::kLevelSet:
      return show_level_set(radiance, o, s);
    case ToneOperator::kBilateral:
      return show_bilateral(radiance, o, s);
    default:
      return show_photographic(radiance, o, s);
  }
}

}  // namespace

Result<ToneOperator> parse_tone_operator(std::string_view name) {
  for (const NamedOperator& o : kOperators)
    if (o.name == name) return o.op;
  return fail(ErrorCode::kInvalid, std::string(name),
              "is no operator: level-set, photographic, photographic-local, bilateral or filmic");
}

Result<ToneMapped> tone_map(const Image<Rgb>& radiance, const ToneOptions& options) {
  PENUMBRA_TRY(check_options(options));
  PENUMBRA_ASSIGN(statistics, measure_tone(radiance));
  return tone_map(radiance, options, statistics);
}

Result<ToneMapped> tone_map(const Image<Rgb>& radiance, const ToneOptions& options,
                            const ToneStatistics& statistics) {
  PENUMBRA_TRY(check_options(options));
  ToneMapped out;
  out.statistics = statistics;
  const bool has_detail =
      options.op == ToneOperator::kLevelSet || options.op == ToneOperator::kBilateral;
  if (statistics.black) {
    out.pixels.reset(radiance.width(), radiance.height());
    if (has_detail) out.detail.reset(radiance.width(), radiance.height());
    return out;
  }
  if (options.op == ToneOperator::kFilmic) {
    out.pixels = show_film(radiance, options, statistics);
    return out;
  }
  PENUMBRA_ASSIGN(shown, show(radiance, options, statistics));
  const float floor = has_detail ? darkest(statistics) : std::numeric_limits<float>::min();
  out.pixels = colour(radiance, shown.luminance, floor, options.saturation);
  out.detail = std::move(shown.detail);
  return out;
}

}  // namespace penumbra::tone
