#include "core/normal_quantiles.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace penumbra {
namespace {

TEST(NormalQuantiles, AreThoseOfTheNormalDistribution) {
  const std::vector<float> table = normal_quantiles(4096);
  ASSERT_EQ(table.size(), 4096U);
  EXPECT_TRUE(std::ranges::is_sorted(table));
  double square = 0;
  for (std::size_t i = 0; i < table.size(); ++i) {
    EXPECT_EQ(table[i], -table[table.size() - 1 - i]);
    square += double(table[i]) * double(table[i]);
  }
  EXPECT_NEAR(square / 4096, 1, 1e-6);
  // 84.13 % lie below one standard deviation, 97.72 % below two.
  EXPECT_NEAR(table[3446], 1, .002);
  EXPECT_NEAR(table[4002], 2, .005);
}

}  // namespace
}  // namespace penumbra
