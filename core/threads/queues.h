// The ways in which stages meet across threads. All have a close and a drop counter.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <span>
#include <utility>

#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra {

/// What all ways of meeting share: closing lets everyone go who waits.
/// threads: thread-safe
class Closable {
 public:
  void close() {
    {
      const std::scoped_lock lock(mutex_);
      closed_ = true;
    }
    changed_.notify_all();
  }
  bool closed() const {
    const std::scoped_lock lock(mutex_);
    return closed_;
  }
  std::uint64_t dropped() const {
    const std::scoped_lock lock(mutex_);
    return dropped_;
  }

 protected:
  Closable() = default;
  ~Closable() = default;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::uint64_t dropped_ = 0;  // guarded by mutex_
  bool closed_ = false;        // guarded by mutex_
};

/// One-slot mailbox: the newest value wins, an unread one is dropped and counted.
/// threads: thread-safe, any number of writers and readers
template <class T>
class Latest : public Closable {
 public:
  void put(T value) {
    std::optional<T> dropped;  // ends outside the lock
    {
      const std::scoped_lock lock(mutex_);
      if (closed_) return;
      if (slot_) ++dropped_;
      dropped = std::exchange(slot_, std::move(value));
    }
    changed_.notify_one();
  }

  /// Takes the value if there is one; never waits.
  std::optional<T> take() {
    const std::scoped_lock lock(mutex_);
    return std::exchange(slot_, std::nullopt);
  }
  /// Whether there is a value to take.
  bool waiting() const {
    const std::scoped_lock lock(mutex_);
    return slot_.has_value();
  }

  /// Waits for a value until `timeout`; nothing after the timeout or once closed and empty.
  std::optional<T> wait(Seconds timeout) {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [&] { return slot_.has_value() || closed_; });
    return std::exchange(slot_, std::nullopt);
  }

 private:
  std::optional<T> slot_;  // guarded by mutex_
};

/// First-in first-out queue of at most `capacity` values.
/// threads: thread-safe, any number of writers and readers
template <class T>
class Bounded : public Closable {
 public:
  explicit Bounded(std::size_t capacity) : capacity_(capacity) {}

  /// Waits for room. False once closed: the value is not taken.
  bool push(T value) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return items_.size() < capacity_ || closed_; });
    if (closed_) return false;
    items_.push_back(std::move(value));
    lock.unlock();
    changed_.notify_all();
    return true;
  }

  /// Never waits: a full queue drops the value and counts it.
  bool try_push(T value) { return try_push_all(std::span(&value, 1)); }
  /// All of them in one, or none.
  bool try_push_all(std::span<T> values) {
    {
      const std::scoped_lock lock(mutex_);
      if (closed_) return false;
      if (items_.size() + values.size() > capacity_) {
        dropped_ += values.size();
        return false;
      }
      for (T& value : values) items_.push_back(std::move(value));
    }
    changed_.notify_all();
    return true;
  }

  /// Waits for a value; nothing once closed and drained.
  std::optional<T> pop() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return !items_.empty() || closed_; });
    if (items_.empty()) return std::nullopt;
    T value = std::move(items_.front());
    items_.pop_front();
    lock.unlock();
    changed_.notify_all();
    return value;
  }

 private:
  const std::size_t capacity_;
  std::deque<T> items_;  // guarded by mutex_
};

}  // namespace penumbra
#pragma GCC visibility pop
