#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "prt/prt.h"
#include "tests/prt/transfers.h"
#include "tests/support/lights.h"

namespace penumbra::prt {
namespace {

using test::random_transfer;

struct Sum {
  double value = 0, magnitude = 0;
};

Sum plain_sum(const Transfer& transfer, const RadianceSh& light, int colour, std::size_t point) {
  Sum sum;
  for (int n = 0; n < std::min(light.size(), coefficient_count(transfer.bands)); ++n) {
    const double term = double(light[n][colour]) *
                        double(transfer.value(transfer.channels == 1 ? 0 : colour, n, point));
    sum.value += term;
    sum.magnitude += std::abs(term);
  }
  return sum;
}

void expect_plain_loop(const Transfer& transfer, const RadianceSh& light) {
  std::vector<float> out(3 * transfer.stride, NAN);
  relight(transfer, light, out);
  for (int c = 0; c < 3; ++c)
    for (std::size_t p = 0; p < transfer.stride; ++p) {
      const float v = out[static_cast<std::size_t>(c) * transfer.stride + p];
      if (p >= transfer.points) {
        ASSERT_EQ(v, 0) << "padding";
        continue;
      }
      // The halves are read exactly; only the sums are in float.
      const Sum sum = plain_sum(transfer, light, c, p);
      ASSERT_NEAR(v, sum.value, 1e-6 * sum.magnitude + 1e-9) << "colour " << c << " point " << p;
    }
}

TEST(Relight, EqualsThePlainLoopForEverySize) {
  for (const std::size_t points : {1uz, 63uz, 64uz, 65uz, 1000uz, 1025uz, 2500uz})
    for (const int channels : {1, 3})
      for (const int bands : {1, 2, 3, 5, 9}) {
        SCOPED_TRACE(testing::Message()
                     << points << " points, " << channels << " channels, " << bands);
        expect_plain_loop(random_transfer(bands, channels, points, 1),
                          test::random_light(bands, 2));
      }
}

TEST(Relight, FurtherBandsOfTheLightAreIgnoredAndMissingOnesAreZero) {
  for (const int channels : {1, 3}) {
    const Transfer transfer = random_transfer(4, channels, 100, 3);
    expect_plain_loop(transfer, test::random_light(9, 4));
    expect_plain_loop(transfer, test::random_light(2, 5));
    std::vector<float> a(3 * transfer.stride), b(3 * transfer.stride);
    const RadianceSh light = test::random_light(9, 6);
    relight(transfer, light, a);
    relight(transfer, light.with_bands(4), b);
    EXPECT_EQ(a, b);
  }
}

TEST(Relight, ZeroLightGivesZero) {
  const Transfer transfer = random_transfer(5, 3, 200, 7);
  std::vector<float> out(3 * transfer.stride, NAN);
  relight(transfer, RadianceSh(5), out);
  for (const float v : out) ASSERT_EQ(v, 0);
}

TEST(Relight, ColoursOfTheLightStayApart) {
  const Transfer transfer = random_transfer(2, 1, 70, 8);
  RadianceSh green(2);
  for (Rgb& t : green.terms()) t = {0, 1, 0};
  std::vector<float> out(3 * transfer.stride, NAN);
  relight(transfer, green, out);
  for (std::size_t p = 0; p < transfer.stride; ++p) {
    ASSERT_EQ(out[p], 0);
    ASSERT_EQ(out[2 * transfer.stride + p], 0);
  }
  EXPECT_NE(out[transfer.stride], 0);
}

TEST(Relight, HoldsAMillionToOneLight) {
  const Transfer transfer = random_transfer(3, 1, 128, 9);
  RadianceSh light = test::random_light(3, 10);
  for (Rgb& t : light.terms()) t = t * 1e6f;
  expect_plain_loop(transfer, light);
}

TEST(Transfer, ValuesRoundToHalfAndStandWhereTheLayoutSays) {
  Transfer transfer(2, 3, 65);
  EXPECT_EQ(transfer.stride, 128u);
  EXPECT_EQ(transfer.values.size(), 3u * 4 * 128);
  transfer.set(2, 3, 64, 1 / 3.f);
  EXPECT_EQ(transfer.index(2, 3, 64), (2u * 4 + 3) * 128 + 64);
  EXPECT_NEAR(transfer.value(2, 3, 64), 1 / 3.f, 0x1p-11 / 3);
  EXPECT_NE(transfer.values[transfer.index(2, 3, 64)], 0);
  EXPECT_EQ(Transfer(1, 1, 64).stride, 64u);
}

}  // namespace
}  // namespace penumbra::prt
