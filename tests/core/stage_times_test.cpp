#include "core/threads/stage_times.h"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

TEST(StageTimes, PercentilesAreOfWhatCameLastAndCountsOfAll) {
  StageTimes times;
  for (int i = 0; i < 20'000; ++i) times.add("composite", 100);  // while objects were baked
  for (std::size_t i = 0; i < StageTimes::kLastSamples; ++i) times.add("composite", i % 100 + 1.);
  const auto summary = times.summary();
  ASSERT_EQ(summary.size(), 1u);
  EXPECT_EQ(summary[0].first, "composite");
  EXPECT_NEAR(summary[0].second.p50_ms, 50, 1);
  EXPECT_NEAR(summary[0].second.p99_ms, 99, 1);
  EXPECT_EQ(summary[0].second.count, 20'000 + StageTimes::kLastSamples);
  EXPECT_EQ(times.histograms()[0].second.count, 20'000 + StageTimes::kLastSamples);
}

}  // namespace
}  // namespace penumbra
