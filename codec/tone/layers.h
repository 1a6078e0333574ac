// Pieces of tone mapping: what separates a picture's base from its detail.
// They take and give pictures of one number a pixel; borders repeat their pixel.
// threads: reentrant; parallel inside, the same bits on any number of cores
#pragma once

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::tone {

/// How far the level set moves a picture towards its profile.
struct LevelSetOptions {
  int steps = 15;          // 0..1000; 0: the picture is its own profile
  double time_step = .12;  // in squared pixels, above 0 up to 100; long ones are divided
  double sensitivity = 8;  // to edges, 0..1000; 0: edges are smoothed like everything
};

/// Profile of a picture by the curvature flow of its surface, which stops at edges. At any time
/// step it stays between the picture's smallest and largest value.
/// in:      natural logarithms of luminance, finite; range: their range, which the equation wants
///          stretched to 10, above 0
/// out:     where `sensitivity` is above 0, within level_set_bound() of the picture
/// errors:  kInvalid (an option, the range), kNonFinite (first bad pixel)
/// source:  Xu 2005, "Real-time realistic rendering and high dynamic range image display and
///          compression", equations 3.4 to 3.10; differs: docs/methods/tone-mapping.md
Result<Image<float>> level_set_profile(const Image<float>& log_luminance, double range,
                                       const LevelSetOptions& options = {});

/// The largest detail that the level set leaves anywhere, so also the largest halo at an edge, in
/// natural logarithms: sqrt(2) steps time_step / (e sensitivity), times range / 10. Without
/// sensitivity it is infinite.
double level_set_bound(double range, const LevelSetOptions& options = {});

struct BilateralOptions {
  double sigma_px = 16;      // in the picture, at least 4
  double sigma_range = .92;  // in the values, above 0; .4 decades in natural logarithms
};

/// Base of a picture by the bilateral filter: an average of pixels that are near and alike.
/// in:      finite values
/// out:     values that lie 4 sigma_range apart or more do not mix at all
/// errors:  kInvalid (an option; more than 2^25 cells), kNonFinite (first bad pixel)
/// source:  Durand & Dorsey 2002; Chen, Paris & Durand 2007 for the grid; differs: binomial weights
///          in place of Gaussian ones; the range has 128 cells at most, wider where it must be
Result<Image<float>> bilateral_base(const Image<float>& values, const BilateralOptions& options);

}  // namespace penumbra::tone
#pragma GCC visibility pop
