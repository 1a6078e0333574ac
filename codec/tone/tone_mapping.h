// Pictures of a wide range of luminance on an ordinary display: tone mapping.
// threads: reentrant; parallel inside, the same bits on any number of cores
#pragma once

#include <cstddef>
#include <optional>
#include <string_view>
#include <utility>

#include "codec/tone/layers.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::tone {

enum class ToneOperator {
  kLevelSet,           // Xu 2005, chapter 3: the profile is compressed, detail stays
  kPhotographic,       // Reinhard et al. 2002, one curve for all pixels
  kPhotographicLocal,  // the same with dodging and burning
  kBilateral,          // Durand & Dorsey 2002: the base is compressed, detail stays
  kFilmic,             // exposure and a film's curve, channel by channel: Hable 2010
};

/// By the names level-set, photographic, photographic-local, bilateral, filmic.
/// errors: kInvalid, with the names
Result<ToneOperator> parse_tone_operator(std::string_view name);

struct ToneOptions {
  ToneOperator op = ToneOperator::kLevelSet;
  double exposure_stops = 0;  // -32..32; each doubles the light
  // What the scene's middle luminance is shown as, 0.01..0.9 of white. Unset: .18 for the level
  // set, else by where the middle lies between dark and bright.
  std::optional<double> key{};
  // Part of a colour's distance from grey of its luminance that is kept, 0..2; not filmic. Below 1,
  // since with less contrast the same colours look stronger.
  double saturation = .85;
  LevelSetOptions level_set{};
  double contrast = .73;  // exponent of the level set's S-curve, 0.1..4
  // Photographic and filmic: the luminance shown white, in multiples of the middle one, above 1.
  // Unset: that of the brightest thousandth of the pixels; of film 11.2 times what is exposed as 1.
  std::optional<double> white{};
  double sharpness = 8;             // phi of photographic-local, 0..64
  double bilateral_fraction = .02;  // sigma, of the picture's longer side, 0.001..0.5
  double bilateral_decades = .4;    // sigma, of luminance, 0.01..4
  double base_decades = 1.4;        // range that the bilateral base is compressed to, 0.1..8
};

/// What an operator adapts to: natural logarithms of luminance. Pixels without light do not count.
struct ToneStatistics {
  bool black = true;  // no pixel has light; the others are 0 then
  double mean = 0, median = 0;
  double low = 0, high = 0;  // a thousandth of the pixels is darker, or brighter
  std::size_t negative = 0;  // pixels with a component below 0, which counts as 0

  /// At least a decade, so that noise on an even picture is not taken for its range.
  [[nodiscard]] double range() const;
};

/// errors: kInvalid (no pixels), kNonFinite (first bad pixel)
Result<ToneStatistics> measure_tone(const Image<Rgb>& radiance);

struct ToneMapped {
  Image<Rgb8> pixels;  // sRGB
  // Natural logarithm of luminance without its profile or base; empty where an operator has none.
  Image<float> detail;
  ToneStatistics statistics;
};

/// Shows radiance on a display. A colour that is brighter than the display can show keeps its
/// luminance as far as that goes, and pales. One factor on all radiance changes nothing.
/// in:      linear Rec.709, any unit; components below 0 count as 0; a black picture stays black
/// errors:  kInvalid (no pixels, an option), kNonFinite (first bad pixel)
Result<ToneMapped> tone_map(const Image<Rgb>& radiance, const ToneOptions& options = {});

/// The same, adapted to given statistics in place of the picture's own: see TemporalTone. The
/// picture must be finite, as measure_tone() makes sure.
Result<ToneMapped> tone_map(const Image<Rgb>& radiance, const ToneOptions& options,
                            const ToneStatistics& statistics);

/// Luminance of the display, 0..1, from that of the scene, in which `key` stands for the middle.
/// in:      finite, not negative; white above 0; with `local` each pixel adapts to its surroundings
///          as far as they are even, by sharpness phi
/// errors:  kInvalid (an option), kNonFinite (first bad pixel)
/// source:  Reinhard, Stark, Shirley & Ferwerda 2002, equations 4 to 9
Result<Image<float>> photographic(const Image<float>& luminance, double white, bool local,
                                  double sharpness = 8);

/// A film's response, 0..1, to an exposed component; `white` becomes 1.
/// source: Hable 2010, "Uncharted 2: HDR Lighting"
float filmic_curve(float exposed, float white = 11.2f);

/// Each component through filmic_curve() behind one factor.
Image<Rgb> filmic_exposure(const Image<Rgb>& radiance, double factor, double white = 11.2);

}  // namespace penumbra::tone
#pragma GCC visibility pop
