#include "core/threads/scratch.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <numeric>

namespace penumbra {
namespace {

using Numbers = std::pmr::vector<int>;

Numbers counted(const Scratch::Scope& scope, int count) {
  Numbers out(static_cast<std::size_t>(count), scope.memory());
  std::iota(out.begin(), out.end(), 0);
  return out;
}

TEST(Scratch, ServesAgainFromTheSameMemoryOnceItHasGrown) {
  const auto address = [] {
    const Scratch::Scope scope;
    const Numbers numbers = counted(scope, 10'000);
    EXPECT_EQ(numbers.back(), 9'999);
    const auto place = reinterpret_cast<std::uintptr_t>(numbers.data());
    return place;
  };
  (void)address();  // grows
  const auto second = address();
  EXPECT_EQ(second, address());
}

TEST(Scratch, InnerScopeLeavesTheOuterOnesMemoryAlone) {
  for (int round = 0; round < 3; ++round) {  // while it grows, and after
    const Scratch::Scope outer;
    const Numbers kept = counted(outer, 1000);
    for (int k = 0; k < 50; ++k) {
      const Scratch::Scope inner;
      Numbers gone = counted(inner, 5000);
      std::ranges::fill(gone, -1);
    }
    for (int i = 0; i < 1000; ++i) ASSERT_EQ(kept[static_cast<std::size_t>(i)], i);
  }
}

TEST(Scratch, AlignsWhatItHandsOut) {
  struct alignas(64) Wide {
    char c[64];
  };
  for (int round = 0; round < 2; ++round) {
    const Scratch::Scope scope;
    const std::pmr::vector<char> odd(3, 'x', scope.memory());
    const std::pmr::vector<Wide> wide(5, Wide{}, scope.memory());
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(wide.data()) % 64, 0u);
  }
}

}  // namespace
}  // namespace penumbra
