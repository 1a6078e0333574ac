// The threads that answer: as many as there are clients, up to a limit.
// threads: thread-safe
#pragma once

#include <httplib.h>

#include <chrono>
#include <condition_variable>
#include <deque>
#include <functional>
#include <iterator>
#include <list>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "core/threads/parallel.h"

namespace penumbra::service {

/// A client that keeps its connection holds a thread. A thread is made when none waits, and ends
/// when it has waited for long. None holds up the pipeline.
class Workers : public httplib::TaskQueue {
 public:
  explicit Workers(std::size_t limit,
                   std::chrono::milliseconds longest_wait = std::chrono::seconds(30))
      : limit_(limit), longest_wait_(longest_wait) {}
  void enqueue(std::function<void()> task) override {
    {
      const std::scoped_lock lock(mutex_);
      join_ended();
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
    for (std::thread& thread : threads_)
      if (thread.joinable()) thread.join();
  }

 private:
  using Place = std::list<std::thread>::iterator;

  // In the lock. Where the system has no more threads the task waits for those that there are.
  void add_worker() {
    threads_.emplace_back();
    const auto place = std::prev(threads_.end());
    try {
      *place = std::thread([this, place] { work(place); });
    } catch (const std::system_error&) {
      threads_.erase(place);
      if (threads_.empty()) throw;
    }
  }
  // In the lock, which those that have ended no longer take.
  void join_ended() {
    for (const Place place : ended_) {
      place->join();
      threads_.erase(place);
    }
    ended_.clear();
  }
  void work(Place place) {
    work_in_background();
    std::unique_lock lock(mutex_);
    while (true) {
      ++waiting_;
      const bool comes =
          changed_.wait_for(lock, longest_wait_, [&] { return !tasks_.empty() || ends_; });
      --waiting_;
      if (!comes) {
        ended_.push_back(place);
        return;
      }
      if (tasks_.empty()) return;
      const std::function<void()> task = std::move(tasks_.front());
      tasks_.pop_front();
      lock.unlock();
      task();
      lock.lock();
    }
  }

  const std::size_t limit_;
  const std::chrono::milliseconds longest_wait_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::function<void()>> tasks_;  // guarded by mutex_, as are all below
  std::size_t waiting_ = 0;
  bool ends_ = false;
  std::list<std::thread> threads_;
  std::vector<Place> ended_;  // to be joined
};

}  // namespace penumbra::service
