// Work beside other work. What the thread sanitizer sees instead of libtbb: parallel.cpp.
// threads: thread-bound
#pragma once

#include <oneapi/tbb/task_arena.h>
#include <oneapi/tbb/task_group.h>

#if defined(__SANITIZE_THREAD__)
#include <future>
#endif

#include "core/threads/processor_time.h"

#pragma GCC visibility push(default)
namespace penumbra {

// One piece of work beside the caller's, on a core that has none; at the latest in wait().
class BackgroundTask {
 public:
  BackgroundTask() = default;
  ~BackgroundTask() { wait_quietly(); }
  BackgroundTask(const BackgroundTask&) = delete;
  BackgroundTask& operator=(const BackgroundTask&) = delete;

#if defined(__SANITIZE_THREAD__)
  template <class Work>
  void run(const Work& work) {
    running_ = std::async(std::launch::async, [work, use = spending_on()] {
      const SpendingOn spending(use);
      work();
    });
  }
  // An exception of the work comes out of here.
  void wait() {
    if (running_.valid()) running_.get();
  }

 private:
  std::future<void> running_;
#else
  template <class Work>
  void run(const Work& work) {
    group_.run([work, use = spending_on()] {
      const SpendingOn spending(use);
      work();
    });
  }
  // An exception of the work comes out of here.
  void wait() {
    group_.wait();
  }

 private:
  tbb::task_group group_;
#endif
  void wait_quietly() noexcept {
    try {
      wait();
    } catch (...) {  // NOLINT(bugprone-empty-catch): nobody is left who would be told
    }
  }
};

// work(), whose parallel loops take up nothing from outside it while they wait for their last
// parts: what they are timed by is their own.
template <class Work>
auto isolate(const Work& work) {
#if defined(__SANITIZE_THREAD__)
  return work();
#else
  return tbb::this_task_arena::isolate(work);
#endif
}

}  // namespace penumbra
#pragma GCC visibility pop
