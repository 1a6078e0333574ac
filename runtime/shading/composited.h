// A composited view frame.
// threads: a plain value
#pragma once

#include "capture/frames.h"
#include "compositor/composite_stats.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

struct Composited {
  FramePixels pixels;
  compositor::CompositeStats touched;
  bool relit = false;
};

}  // namespace penumbra::runtime
#pragma GCC visibility pop
