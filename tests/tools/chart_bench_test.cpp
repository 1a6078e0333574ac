#include "tools/chart/benches/chart_bench.h"
#include "prt/prt.h"

#include <gtest/gtest.h>

#include "tests/prt/transfers.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

// What a bake of fewer bands would have, in the same places.
TEST(ChartBench, FewerBandsAreTheSameCoefficients) {
  for (const int channels : {1, 3}) {
    const prt::Transfer all = test::random_transfer(4, channels, 100, 1);
    for (const int bands : {1, 3, 4, 9}) {
      const prt::Transfer some = with_bands(all, bands);
      ASSERT_EQ(some.bands, std::min(bands, 4));
      ASSERT_EQ(some.channels, channels);
      ASSERT_EQ(some.points, all.points);
      ASSERT_EQ(some.values.size(), prt::Transfer(some.bands, channels, all.points).values.size());
      for (int c = 0; c < channels; ++c)
        for (int n = 0; n < coefficient_count(some.bands); ++n)
          for (std::size_t p = 0; p < all.points; ++p)
            ASSERT_EQ(some.value(c, n, p), all.value(c, n, p)) << bands;
    }
  }
  EXPECT_EQ(with_bands({}, 3).points, 0U);
}

}  // namespace
}  // namespace penumbra::tools
