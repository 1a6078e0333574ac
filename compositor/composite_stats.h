// What a composite touched.
// threads: a plain value
#pragma once

#include <cstddef>

#pragma GCC visibility push(default)
namespace penumbra::compositor {

struct CompositeStats {
  std::size_t pixels = 0;  // written
  double fraction = 0;     // of the frame
};

}  // namespace penumbra::compositor
#pragma GCC visibility pop
