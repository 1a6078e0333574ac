#pragma once

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <concepts>
#include <type_traits>

#if defined(__SANITIZE_THREAD__)
#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#endif

// Loops spread over the machine's cores by TBB. The call returns when all is done; an exception of a body ends the
// loop and comes out of the call. Bodies run at the same time on several threads and share no mutable state.
//
// The thread sanitizer can't see libtbb hand work from thread to thread and would call every such loop a race. In
// its build the loops run on threads that it sees, so that it judges the bodies.
namespace penumbra {

// A part of [begin, end), handed to a body.
template <std::integral Index>
struct Indices {
  Index first, last;
  [[nodiscard]] Index begin() const { return first; }
  [[nodiscard]] Index end() const { return last; }
  [[nodiscard]] Index size() const { return static_cast<Index>(last - first); }
};

// body(Indices) over [first, last) in parts of about `grain` (at least 1) indices.
template <std::integral Index, class Body>
void parallel_for(Index first, std::type_identity_t<Index> last, std::type_identity_t<Index> grain,
                  const Body& body) {
#if defined(__SANITIZE_THREAD__)
  std::atomic<Index> next{first};
  std::mutex mutex;
  std::exception_ptr failed;
  const auto work = [&] {
    try {
      for (Index at = next.fetch_add(grain); at < last; at = next.fetch_add(grain))
        body(Indices<Index>{at, static_cast<Index>(at + std::min<Index>(grain, last - at))});
    } catch (...) {
      next = last;
      const std::scoped_lock lock(mutex);
      failed = std::current_exception();
    }
  };
  if (first >= last) return;
  if (last - first > grain) {
    const std::jthread second(work);
    work();
  } else {
    work();
  }
  if (failed) std::rethrow_exception(failed);
#else
  tbb::parallel_for(tbb::blocked_range<Index>(first, last, grain),
                    [&](const tbb::blocked_range<Index>& part) {
                      body(Indices<Index>{part.begin(), part.end()});
                    });
#endif
}

// body(index) over [first, last), for bodies that are dear one by one.
template <std::integral Index, class Body>
void parallel_for(Index first, std::type_identity_t<Index> last, const Body& body) {
  parallel_for(first, last, 1, [&](const Indices<Index>& part) {
    for (Index i = part.begin(); i < part.end(); ++i) body(i);
  });
}

}  // namespace penumbra
