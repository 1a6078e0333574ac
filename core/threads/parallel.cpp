#include "core/threads/parallel.h"

#include <sys/resource.h>
#include <unistd.h>

#include <cassert>

#include "core/threads/processor_time.h"

#if defined(__SANITIZE_THREAD__)
#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#else
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#endif

namespace penumbra {

namespace {

thread_local bool loops_alone = false;

}  // namespace

void work_in_background() {
  constexpr int kNice = 10;  // a tenth of a share
  loops_alone = true;
  // Refused, it is as it was.
  (void)::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kNice);
}

namespace detail {

#if defined(__SANITIZE_THREAD__)

// The thread sanitizer can't see libtbb hand work from thread to thread and would call every loop a
// race. In its build loops run on threads that it sees, so that it judges the bodies.
void run_parts(std::int64_t first, std::int64_t last, std::int64_t grain, const void* body,
               LoopBody part) {
  assert(grain > 0);
  if (first >= last) return;
  if (loops_alone) return part(body, first, last);
  std::atomic<std::int64_t> next{first};
  std::mutex mutex;
  std::exception_ptr failed;
  const ProcessorUse use = spending_on();
  const auto work = [&] {
    const SpendingOn spending(use);
    try {
      for (std::int64_t at = next.fetch_add(grain); at < last; at = next.fetch_add(grain))
        part(body, at, std::min(at + grain, last));
    } catch (...) {
      next = last;
      const std::scoped_lock lock(mutex);
      failed = std::current_exception();
    }
  };
  if (last - first > grain) {
    const std::jthread second(work);
    work();
  } else {
    work();
  }
  if (failed) std::rethrow_exception(failed);
}

#else

void run_parts(std::int64_t first, std::int64_t last, std::int64_t grain, const void* body,
               LoopBody part) {
  assert(grain > 0);
  if (loops_alone && first < last) return part(body, first, last);
  using Range = tbb::blocked_range<std::int64_t>;
  const ProcessorUse use = spending_on();
  // Parts of other loops may be done while this one is waited for.
  const SpendingOn stays(use);
  tbb::parallel_for(Range(first, last, static_cast<std::size_t>(grain)), [&](const Range& some) {
    // A worker stays with it until it takes up another loop: to ask its clock at each part would
    // cost more than the parts of small loops.
    spend_on(use);
    part(body, some.begin(), some.end());
  });
}

#endif

}  // namespace detail
}  // namespace penumbra
