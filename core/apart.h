#pragma once

#include <oneapi/tbb/task_arena.h>

namespace penumbra {

// work(), whose parallel loops take up nothing from outside it while they wait for their last parts: what they are timed
// by is their own. See core/parallel.h for the thread sanitizer.
template <class Work>
auto apart(const Work& work) {
#if defined(__SANITIZE_THREAD__)
  return work();
#else
  return tbb::this_task_arena::isolate(work);
#endif
}

}  // namespace penumbra
