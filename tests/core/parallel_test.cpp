#include "core/threads/parallel.h"

#include <gtest/gtest.h>

#include <atomic>
#include <stdexcept>
#include <vector>

namespace penumbra {
namespace {

TEST(ParallelFor, VisitsEachIndexOnce) {
  for (const int count : {0, 1, 7, 8, 9, 1000}) {
    std::vector<int> visits(static_cast<std::size_t>(count), 0);
    parallel_for(0, count, 8, [&](const Indices<int>& part) {
      for (int i = part.begin(); i < part.end(); ++i) ++visits[static_cast<std::size_t>(i)];
    });
    for (const int v : visits) EXPECT_EQ(v, 1) << count;
  }
  std::vector<int> visits(100, 0);
  parallel_for(std::size_t{10}, visits.size(), [&](std::size_t i) { ++visits[i]; });
  for (std::size_t i = 0; i < visits.size(); ++i) EXPECT_EQ(visits[i], i < 10 ? 0 : 1) << i;
}

TEST(ParallelFor, LoopsMayNest) {
  std::atomic<int> sum = 0;
  parallel_for(0, 20, [&](int i) { parallel_for(0, i, [&](int) { ++sum; }); });
  EXPECT_EQ(sum, 190);
}

TEST(ParallelFor, AnExceptionOfABodyComesOut) {
  EXPECT_THROW(parallel_for(0, 1000,
                            [&](int i) {
                              if (i == 500) throw std::runtime_error("body");
                            }),
               std::runtime_error);
}

}  // namespace
}  // namespace penumbra
