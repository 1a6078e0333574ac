#include "core/threads/queues.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <future>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace penumbra {
namespace {

using namespace std::chrono_literals;

// Long enough that a loaded machine never reaches it, so that only a hang does.
constexpr auto kLong = 20s;
// Long enough to see that a thread waits; too short only makes a test weaker, never wrong.
constexpr auto kShort = 20ms;

template <class T>
bool waits(std::future<T>& result) {
  return result.wait_for(kShort) == std::future_status::timeout;
}
template <class T>
bool ends(std::future<T>& result) {
  return result.wait_for(kLong) == std::future_status::ready;
}

// ------------------------------------------------------------------------------------- Latest

TEST(Latest, NewestWinsAndUnreadOnesAreCounted) {
  Latest<int> box;
  for (int i = 1; i <= 5; ++i) box.put(i);
  EXPECT_EQ(box.dropped(), 4u);
  EXPECT_EQ(box.take(), 5);
  EXPECT_EQ(box.take(), std::nullopt) << "each value is taken once";
  box.put(6);
  EXPECT_EQ(box.dropped(), 4u) << "a value that was read is not a drop";
}

TEST(Latest, WaitEndsAtTheTimeoutWithNothing) {
  Latest<int> box;
  const auto start = std::chrono::steady_clock::now();
  EXPECT_EQ(box.wait(Seconds(.03)), std::nullopt);
  EXPECT_GE(std::chrono::steady_clock::now() - start, 29ms);
}

TEST(Latest, WaitReturnsAValueThatIsThereAtOnce) {
  Latest<int> box;
  box.put(3);
  EXPECT_EQ(box.wait(Seconds(0)), 3);
}

TEST(Latest, PutWakesAWaitingReader) {
  Latest<int> box;
  auto reader = std::async(std::launch::async, [&] { return box.wait(kLong); });
  EXPECT_TRUE(waits(reader));
  box.put(7);
  ASSERT_TRUE(ends(reader));
  EXPECT_EQ(reader.get(), 7);
}

TEST(Latest, CloseReleasesEveryWaitingReader) {
  Latest<int> box;
  std::vector<std::future<std::optional<int>>> readers;
  for (int i = 0; i < 4; ++i)
    readers.push_back(std::async(std::launch::async, [&] { return box.wait(Seconds(3600)); }));
  EXPECT_TRUE(waits(readers[0]));
  box.close();
  for (auto& reader : readers) {
    ASSERT_TRUE(ends(reader));
    EXPECT_EQ(reader.get(), std::nullopt);
  }
  EXPECT_TRUE(box.closed());
}

TEST(Latest, ClosedKeepsItsLastValueAndTakesNoNewOne) {
  Latest<int> box;
  box.put(1);
  box.close();
  box.put(2);
  EXPECT_EQ(box.dropped(), 0u);
  EXPECT_EQ(box.wait(kLong), 1);
  EXPECT_EQ(box.wait(kLong), std::nullopt);
}

TEST(Latest, ReaderNeverSeesAnOlderValueAfterANewerOne) {
  Latest<int> box;
  constexpr int kCount = 20'000;
  std::uint64_t seen = 0;
  int last = -1;
  const std::jthread writer([&] {
    for (int i = 0; i < kCount; ++i) box.put(i);
    box.close();
  });
  while (const auto value = box.wait(kLong)) {
    EXPECT_GT(*value, last);
    last = *value;
    ++seen;
  }
  EXPECT_EQ(last, kCount - 1) << "the newest always arrives";
  EXPECT_EQ(seen + box.dropped(), std::uint64_t{kCount}) << "nothing is lost uncounted";
}

TEST(Latest, HoldsValuesThatOnlyMove) {
  Latest<std::unique_ptr<int>> box;
  box.put(std::make_unique<int>(4));
  const auto value = box.take();
  ASSERT_TRUE(value && *value);
  EXPECT_EQ(**value, 4);
}

// ------------------------------------------------------------------------------------- Bounded

TEST(Bounded, KeepsTheOrder) {
  Bounded<int> queue(3);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(queue.push(i));
  for (int i = 0; i < 3; ++i) EXPECT_EQ(queue.pop(), i);
}

TEST(Bounded, FullQueueMakesTheWriterWait) {
  Bounded<int> queue(2);
  EXPECT_TRUE(queue.push(1) && queue.push(2));
  auto writer = std::async(std::launch::async, [&] { return queue.push(3); });
  EXPECT_TRUE(waits(writer));
  EXPECT_EQ(queue.pop(), 1);
  ASSERT_TRUE(ends(writer));
  EXPECT_TRUE(writer.get());
  EXPECT_EQ(queue.pop(), 2);
  EXPECT_EQ(queue.pop(), 3);
  EXPECT_EQ(queue.dropped(), 0u);
}

TEST(Bounded, TryPushDropsTheNewOneAndCounts) {
  Bounded<int> queue(2);
  EXPECT_TRUE(queue.try_push(1));
  EXPECT_TRUE(queue.try_push(2));
  EXPECT_FALSE(queue.try_push(3));
  EXPECT_FALSE(queue.try_push(4));
  EXPECT_EQ(queue.dropped(), 2u);
  EXPECT_EQ(queue.pop(), 1);
  EXPECT_TRUE(queue.try_push(5));
  EXPECT_EQ(queue.pop(), 2);
  EXPECT_EQ(queue.pop(), 5);
}

TEST(Bounded, DrainsAfterCloseAndThenEnds) {
  Bounded<int> queue(4);
  EXPECT_TRUE(queue.push(1) && queue.push(2));
  queue.close();
  EXPECT_FALSE(queue.push(3)) << "closed to new values";
  EXPECT_FALSE(queue.try_push(3));
  EXPECT_EQ(queue.dropped(), 0u) << "a drop is a value lost to a full queue";
  EXPECT_EQ(queue.pop(), 1);
  EXPECT_EQ(queue.pop(), 2);
  EXPECT_EQ(queue.pop(), std::nullopt);
}

TEST(Bounded, CloseReleasesWaitingReadersAndWriters) {
  Bounded<int> empty(1), full(1);
  EXPECT_TRUE(full.push(0));
  std::vector<std::future<bool>> waiting;
  for (int i = 0; i < 3; ++i) {
    waiting.push_back(std::async(std::launch::async, [&] { return empty.pop().has_value(); }));
    waiting.push_back(std::async(std::launch::async, [&] { return full.push(1); }));
  }
  for (auto& w : waiting) EXPECT_TRUE(waits(w));
  empty.close();
  full.close();
  for (auto& w : waiting) {
    ASSERT_TRUE(ends(w));
    EXPECT_FALSE(w.get());
  }
  EXPECT_EQ(full.pop(), 0) << "what was in it is not lost";
}

TEST(Bounded, EveryValueOfManyWritersArrivesOnce) {
  constexpr int kWriters = 4, kEach = 2000;
  Bounded<std::pair<int, int>> queue(8);
  std::vector<std::vector<int>> seen(kWriters);
  std::mutex mutex;
  {
    std::vector<std::jthread> readers, writers;
    for (int r = 0; r < 2; ++r)
      readers.emplace_back([&] {
        while (const auto value = queue.pop()) {
          const std::scoped_lock lock(mutex);
          seen[static_cast<std::size_t>(value->first)].push_back(value->second);
        }
      });
    for (int w = 0; w < kWriters; ++w)
      writers.emplace_back([&, w] {
        for (int i = 0; i < kEach; ++i) EXPECT_TRUE(queue.push({w, i}));
      });
    writers.clear();  // joins them
    queue.close();
  }
  for (auto& values : seen) {
    std::ranges::sort(values);  // two readers may note neighbours in either order
    ASSERT_EQ(values.size(), std::size_t{kEach});
    for (int i = 0; i < kEach; ++i) ASSERT_EQ(values[static_cast<std::size_t>(i)], i);
  }
}

TEST(Bounded, HoldsValuesThatOnlyMove) {
  Bounded<std::unique_ptr<int>> queue(1);
  EXPECT_TRUE(queue.push(std::make_unique<int>(4)));
  const auto value = queue.pop();
  ASSERT_TRUE(value && *value);
  EXPECT_EQ(**value, 4);
}

}  // namespace
}  // namespace penumbra
