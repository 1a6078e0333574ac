// The pass over the pixels of a frame that need no sensor effects.
#pragma once

#include <cstddef>

#include "compositor/view.h"

namespace penumbra::compositor {

struct Layered;

/// Two regions of a frame that together are all of it and have no pixel in common.
enum class FrameRegion {
  // What the layer of objects does not reach: of that layer only its rectangle is asked for
  kBeside,
  kObjects,  // its rectangle
};

/// Composites one region in place; returns the number of pixels written.
/// threads: two fractions of one frame may be composited side by side
std::size_t composite_fraction(FrameRegion fraction, const View& view, FramePixels& frame,
                               const Layered& in);

}  // namespace penumbra::compositor
