// The threads that answer: as many as there are clients, up to a limit.
// threads: thread-safe
#pragma once

#include <httplib.h>

#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace penumbra::service {

/// A client that keeps its connection holds a thread. A thread is made when none waits.
class Workers : public httplib::TaskQueue {
 public:
  explicit Workers(std::size_t limit) : limit_(limit) {}
  void enqueue(std::function<void()> task) override {
    {
      const std::scoped_lock lock(mutex_);
      tasks_.push_back(std::move(task));
      if (waiting_ < tasks_.size() && threads_.size() < limit_) add_worker();
    }
    changed_.notify_one();
  }
  void shutdown() override {
    {
      const std::scoped_lock lock(mutex_);
      ends_ = true;
    }
    changed_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }

 private:
  // In the lock. Where the system has no more threads the task waits for those that there are.
  void add_worker() {
    try {
      threads_.emplace_back([this] { work(); });
    } catch (const std::system_error&) {
      if (threads_.empty()) throw;
    }
  }
  void work() {
    std::unique_lock lock(mutex_);
    while (true) {
      ++waiting_;
      changed_.wait(lock, [&] { return !tasks_.empty() || ends_; });
      --waiting_;
      if (tasks_.empty()) return;
      const std::function<void()> task = std::move(tasks_.front());
      tasks_.pop_front();
      lock.unlock();
      task();
      lock.lock();
    }
  }

  const std::size_t limit_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::function<void()>> tasks_;  // guarded by mutex_, as are all below
  std::size_t waiting_ = 0;
  bool ends_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace penumbra::service
