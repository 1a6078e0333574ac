// What measures of two pictures ask of them.
// threads: reentrant
#pragma once

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

/// errors: kInvalid (sizes differ, no pixels), kNonFinite (first bad pixel)
Result<void> check_pair(const Image<Rgb>& reference, const Image<Rgb>& test);

/// Luminance, where components below 0 count as 0.
Image<float> shown_luminance(const Image<Rgb>& picture);

/// An error of 0..1 as black, red, yellow, white.
Image<Rgb8> heat_picture(const Image<float>& error);

}  // namespace penumbra::tools
