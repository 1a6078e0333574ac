// FLIP: how large a difference a viewer sees when two pictures alternate in the same place.
// source: Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images";
//         Andersson et al. 2021, "Visualizing Errors in Rendered High Dynamic Range Images"
#pragma once

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

/// Pixels in a degree of the visual field: a display .7 m and 3840 pixels wide, seen from .7 m.
inline constexpr double kFlipPixelsPerDegree = 67;

/// LDR-FLIP of two linear display-referred pictures: 0 (the same) to 1 in every pixel, symmetric in
/// the two. Components outside 0..1 are clipped as a display clips them.
/// needs:   finite pictures of one size; pixels_per_degree at least 1, below it filters vanish
/// threads: reentrant; works on all cores
Image<float> flip(const Image<Rgb>& reference, const Image<Rgb>& test,
                  double pixels_per_degree = kFlipPixelsPerDegree);

/// HDR-FLIP of two radiance pictures: the largest LDR-FLIP of each pixel over exposures, from the
/// one that shows the reference's brightest pixel just short of white to the one that shows its
/// median pixel so. One factor on both pictures changes nothing. Negative radiance counts as 0.
/// errors:  kInvalid (sizes differ, empty, pixels_per_degree below 1), kNonFinite (first bad
///          pixel), kUndetermined (a black reference has no exposure)
/// threads: reentrant; works on all cores
/// source:  Andersson et al. 2021, ACES tone curve; differs: where more than half of the reference
///          is black, the median is that of its other pixels
Result<Image<float>> hdr_flip(const Image<Rgb>& reference, const Image<Rgb>& test,
                              double pixels_per_degree = kFlipPixelsPerDegree);

/// Mean of a FLIP map, the usual single figure; 0 for an empty map.
double mean_flip(const Image<float>& map);

}  // namespace penumbra::tools
