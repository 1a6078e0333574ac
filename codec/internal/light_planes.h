// A picture as planes of whole numbers, of which equal steps look alike; not for other folders.
#pragma once

#include <array>
#include <cstdint>
#include <glm/mat3x3.hpp>
#include <vector>

#include "codec/still_goal.h"
#include "core/image.h"
#include "core/result.h"

namespace penumbra::codec {

/// CIE XYZ of Rec.709's primaries, ITU-R BT.709-6 and IEC 61966-2-1; luminance as elsewhere.
extern const glm::mat3 kXyzFromRgb, kRgbFromXyz;

/// Without components below 0, at the pixel's luminance, or, where that is not above 0, the rest's.
Rgb inside_rec709(const Rgb& p);

/// errors: kNonFinite, kInvalid (first pixel that is not finite, or brighter than 1e30)
Result<void> check_light(const Image<Rgb>& radiance);

inline constexpr int kPlanes = 3, kPlaneBits = 16;

/// What the numbers stand for. Luminance: 0 is black, and c > 0 is 2^(lowest_stop + c /
/// steps_per_stop). Colour: (c - 2^15) / (steps_per_stop * kColourPerStop) from Rec.709's white.
struct LightScale {
  float lowest_stop = 0, steps_per_stop = 0;
};

/// From black to the darkest that is not: a coder's error does not make it black.
inline constexpr float kStopsAboveBlack = 4;

/// Steps of u', v' in one of a stop: a step of luminance and one of colour are the same part of
/// what an eye tells, 1 % and 1/410 (Ward Larson 1998), within half.
inline constexpr float kColourPerStop = 8;

struct LightPlanes {
  LightScale scale;
  int width = 0, height = 0;
  std::array<std::vector<std::int32_t>, kPlanes> codes;  // 0..2^16 - 1; luminance, u', v'
};

/// in:     steps_per_stop: as wished; fewer where the picture's range needs it
/// errors: kNonFinite, kInvalid (first pixel that is not finite, or brighter than 1e30)
/// source: Xu 2005, equations 4.9 and 9.8; Ward Larson 1998 for colour
Result<LightPlanes> planes_from_rgb(const Image<Rgb>& radiance, double steps_per_stop);
Image<Rgb> rgb_from_planes(const LightPlanes& planes);

/// Over the pixels whose truth is not darker than what the scale holds.
StillError error_of(const Image<Rgb>& truth, const Image<Rgb>& decoded, const LightScale& scale);

}  // namespace penumbra::codec
