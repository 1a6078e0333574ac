// The simplified visual difference predictor of Sarnoff: differences of contrast over three scales,
// weighted by what an eye sees of them.
// threads: reentrant
#pragma once

#include <array>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

inline constexpr int kSarnoffScales = 3;

/// Weights of the scales, fine to coarse: the means of 10 / Q over the octaves of the quantiser Q
/// of luminance that ISO/IEC 10918-1, table K.1, recommends; its finest step is 10.
std::array<double, kSarnoffScales> sarnoff_weights();

/// Perceived error of each pixel, 0 where nothing differs. Even changes of brightness are no
/// contrast and count nothing.
/// errors:  kInvalid (sizes differ, empty), kNonFinite (first bad pixel), kUndetermined (a black
///          reference)
/// source:  Xu 2005, section 4.1.1.2 and figure 4.1, after Lubin 1995; differs: contrast is the
///          ratio to the next coarser scale, so that the S-curve of luminance normalises it as well
Result<Image<float>> sarnoff_map(const Image<Rgb>& reference, const Image<Rgb>& test);

/// Mean of the map, the figure of the dissertation; 0 for an empty map.
double mean_sarnoff(const Image<float>& map);

}  // namespace penumbra::tools
