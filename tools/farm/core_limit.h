// Holds a task to the cores that its queue gave it: a queue may count cores and not bind them.
// threads: for all of the process, as long as it lives
#pragma once

#include <oneapi/tbb/global_control.h>

#include <cstddef>
#include <optional>

#include "tools/farm/shard_choice.h"

namespace penumbra::tools {

class CoreLimit {
 public:
  CoreLimit() {
    if (const int cores = cores_of_task(); cores > 0)
      limit_.emplace(tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(cores));
  }

 private:
  std::optional<tbb::global_control> limit_;
};

}  // namespace penumbra::tools
