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
  // The floor that tells a saturated light's power is overexposed: another frame at this factor of
  // the exposure, with Frame::for_light set, would tell.
  std::optional<double> darker_view{};
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
