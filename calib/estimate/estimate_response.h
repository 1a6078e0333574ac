// A camera's response from a bracket.
// threads: reentrant
#pragma once

#include <optional>
#include <span>

#include "calib/camera/response.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Of the codes: below, the curve is a guess, and above, films glow around bright things and it is
/// known least, so that a merge of the very bracket does better without them.
inline constexpr double kFirstReliableCode = 8 / 255., kLastReliableCode = 240 / 255.;

/// Of one bracket, in any order.
using Picture = Image<Rgb8>;
using Pictures = std::span<const Picture* const>;

/// Response from a registered 8-bit bracket, clipped codes left out, made monotone. As of any
/// response 1 is the light that saturates: where longer exposures clip what shorter ones tell, else
/// where the curve leads. Masked pixels are pure blue (0,0,255) registration borders.
/// errors: kInvalid (fewer than 2 pictures, sizes), kUndetermined (equal times, no overlap, one
///         colour)
/// source: Debevec & Malik 1997
Result<Response> estimate_response(Pictures pictures, std::span<const Seconds> times);

struct ResponseCalibration {
  Response response;
  double sigma = 0;  // one standard deviation of the curve, RMS over the codes, of full scale
  // RMS difference between the curves of the left and the right half over the codes that both
  // hold
  std::optional<double> between_places;
};

/// estimate_response with how sure it is.
/// errors: as estimate_response; kUndetermined (the curve depends on the place: local tone mapping)
Result<ResponseCalibration> calibrate_response(Pictures pictures, std::span<const Seconds> times);

}  // namespace penumbra::calib
#pragma GCC visibility pop
