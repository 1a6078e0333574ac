// The bilateral filter as its authors made it fast, as a peer of ours.
// threads: reentrant
#pragma once

#include "core/image.h"

namespace penumbra::bench {

/// Base of a picture of decimal logarithms of luminance: the bilateral filter linear between
/// segments of the range, each a convolution by the FFT at full resolution.
/// source: Durand & Dorsey 2002, section 5.1
Image<float> durand_base(const Image<float>& log10_luminance, double sigma_px,
                         double sigma_decades);

}  // namespace penumbra::bench
