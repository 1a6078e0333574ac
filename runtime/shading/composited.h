// A composited view frame.
// threads: a plain value
#pragma once

#include <optional>

#include "capture/frames.h"
#include "compositor/composite_stats.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

struct Composited {
  FramePixels pixels;
  compositor::CompositeStats touched;
  bool relit = false;
  // A saturated light's power is not known, and the floor that would tell it is overexposed:
  // another frame at this factor of the exposure, with Frame::for_light set, would tell.
  std::optional<double> darker_view{};
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
