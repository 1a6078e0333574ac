// Whether the noise of a still scene is that of pixels and frames by themselves.
#pragma once

#include <span>

#include "calib/camera/response.h"
#include "calib/estimate/noise_calibration.h"

namespace penumbra::calib {

struct NoiseCorrelation {
  double neighbours = 0, frames = 0;  // coefficients, -1 to 1, of the green channel
};

/// Of pixels that are neither clipped nor at code 0 and whose noise exceeds the step of their
/// codes, without those that something moved over: medians of parts of the picture.
/// brightness: of each frame of the series, taken out
/// in: a series with at least 8 frames
NoiseCorrelation noise_correlation(const StillSeries& series, const Response& response,
                                   std::span<const double> brightness);

}  // namespace penumbra::calib
