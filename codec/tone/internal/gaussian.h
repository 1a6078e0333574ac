// Gaussian averages.
// threads: reentrant, parallel inside
#pragma once

#include "core/image.h"

namespace penumbra::tone {

/// The average of pixels around each, weighted by a Gaussian out to three standard deviations;
/// borders repeat their pixel. sigma_px 0 gives the picture itself.
Image<float> gaussian_blur(const Image<float>& in, double sigma_px);

}  // namespace penumbra::tone
