// Frames as screens, videos and JPEG files take them.
// threads: reentrant
#pragma once

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::codec {

/// Eight-bit picture of any frame, for video, JPEG and windows: 16 bit loses its low byte, float
/// frames go through sRGB with `exposure`.
Image<Rgb8> to_display(const FramePixels& pixels, float exposure = 1);

}  // namespace penumbra::codec
#pragma GCC visibility pop
