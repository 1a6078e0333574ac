#include "core/median.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace penumbra {
namespace {

// Values around 100 by a few per cent, cut off at `full`, which differs by the place as a lens's
// vignetting makes it.
std::vector<CensoredValue> noisy(double full, double full_of_last) {
  std::mt19937 random(5);
  std::normal_distribution<double> value(100, 4);
  std::vector<CensoredValue> out;
  constexpr int kCount = 4000;
  for (int i = 0; i < kCount; ++i) {
    const double v = value(random), limit = std::lerp(full, full_of_last, double(i) / kCount);
    out.push_back({static_cast<float>(std::min(v, limit)), v >= limit});
  }
  return out;
}

double mean_of_exact(const std::vector<CensoredValue>& values) {
  double sum = 0, count = 0;
  for (const CensoredValue& v : values)
    if (!v.at_least) sum += double(v.value), ++count;
  return sum / count;
}

TEST(CensoredMedian, IsThePlainOneWithoutBounds) {
  std::vector<CensoredValue> values = {{3, false}, {1, false}, {2, false}};
  EXPECT_EQ(censored_median(values), 2.f);
}

TEST(CensoredMedian, FortyPerCentSaturatedCostNothing) {
  auto values = noisy(101, 101);
  EXPECT_LT(mean_of_exact(values), 98.5) << "the mean of what is not saturated should be too low";
  EXPECT_NEAR(*censored_median(values), 100, .3);
}

TEST(CensoredMedian, VignettedCornersTellWhereMostIsSaturated) {
  auto values = noisy(88, 118);
  ASSERT_GT(std::ranges::count_if(values, &CensoredValue::at_least), 1500);
  EXPECT_NEAR(*censored_median(values), 100, .6);
}

TEST(CensoredMedian, SaysNothingWhereMostIsABound) {
  auto values = noisy(97, 97);
  EXPECT_EQ(censored_median(values), std::nullopt);
  std::vector<CensoredValue> none;
  EXPECT_EQ(censored_median(none), std::nullopt);
}

}  // namespace
}  // namespace penumbra
