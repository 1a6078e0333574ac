#include "core/io/spelling.h"

#include <gtest/gtest.h>

#include <array>

namespace penumbra {
namespace {

TEST(Spelling, DistanceCountsLettersAndSwaps) {
  EXPECT_EQ(spelling_distance("light", "light"), 0U);
  EXPECT_EQ(spelling_distance("lihgt", "light"), 1U);
  EXPECT_EQ(spelling_distance("band", "bands"), 1U);
  EXPECT_EQ(spelling_distance("", "abc"), 3U);
  EXPECT_EQ(spelling_distance("abc", ""), 3U);
  EXPECT_EQ(spelling_distance("kitten", "sitting"), 3U);
}

TEST(Spelling, NearestWordIsNearEnoughOrNone) {
  constexpr std::array known = {"demo", "light", "inspect", "composite"};
  EXPECT_EQ(nearest_word("lihgt", known), "light");
  EXPECT_EQ(nearest_word("compsite", known), "composite");
  EXPECT_EQ(nearest_word("teapot", known), std::nullopt);
  EXPECT_EQ(nearest_word("", known), std::nullopt);
}

}  // namespace
}  // namespace penumbra
