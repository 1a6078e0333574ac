#include "lighting/lights/inplace_vector.h"

#include <gtest/gtest.h>

#include <numeric>
#include <span>

namespace penumbra::lighting {
namespace {

TEST(InplaceVector, IsAListOfAtMostSoMany) {
  InplaceVector<int, 4> v;
  EXPECT_TRUE(v.empty());
  for (int i = 1; i <= 4; ++i) EXPECT_EQ(v.push_back(i), i);
  EXPECT_EQ(v.size(), 4u);
  EXPECT_EQ(v.back(), 4);
  EXPECT_EQ(std::accumulate(v.begin(), v.end(), 0), 10);
  v[1] = 7;
  EXPECT_EQ(std::span<const int>(v)[1], 7);
  v.clear();
  EXPECT_TRUE(v.empty());
}

// What lies behind the last element does not count.
TEST(InplaceVector, EqualIsWhatHoldsTheSame) {
  InplaceVector<int, 3> a, b;
  a.push_back(1), a.push_back(2), b.push_back(1);
  EXPECT_FALSE(a == b);
  a.clear();
  a.push_back(1);
  EXPECT_TRUE(a == b);
  const InplaceVector<int, 3> copy = a;
  a.push_back(5);
  EXPECT_TRUE(copy == b);
}

}  // namespace
}  // namespace penumbra::lighting
