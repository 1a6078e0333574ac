#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "calib/camera/response_table.h"

namespace penumbra {
namespace {

enum class Curve { kLinear, kSrgb, kGamma };

double decode_exactly(Curve curve, double z) {
  if (curve == Curve::kLinear) return z;
  if (curve == Curve::kGamma) return std::pow(z, 2.2);
  return z <= .04045 ? z / 12.92 : std::pow((z + .055) / 1.055, 2.4);
}

std::array<std::vector<float>, 3> table(Curve curve, int bits) {
  const int last = (1 << bits) - 1;
  std::vector<float> decode;
  for (int code = 0; code <= last; ++code)
    decode.push_back(static_cast<float>(decode_exactly(curve, double(code) / last)));
  return {decode, decode, decode};
}

/// Fractional code of a linear value, black level put back, by bisection of the table.
double exact_code(const std::vector<float>& decode, double linear) {
  const auto above = std::ranges::lower_bound(decode, static_cast<float>(linear));
  if (above == decode.begin()) return 0;
  if (above == decode.end()) return double(decode.size() - 1);
  const double low = double(*(above - 1)), high = double(*above);
  return double(above - decode.begin() - 1) + (high > low ? (linear - low) / (high - low) : 1);
}

constexpr Curve kCurves[] = {Curve::kLinear, Curve::kSrgb, Curve::kGamma};
constexpr float kBlacks[] = {0, .01f, .0625f};

TEST(ResponseTable, EveryEightBitCodeComesBack) {
  for (const Curve kind : kCurves)
    for (const float black : kBlacks) {
      const ResponseTable curve(table(kind, 8), black);
      ASSERT_EQ(curve.largest_code(), 255U);
      for (unsigned code = 0; code < 256; ++code)
        for (int c = 0; c < 3; ++c) {
          EXPECT_EQ(curve.encode(c, curve.decode(c, code)), code)
              << "curve " << int(kind) << " black " << black;
          EXPECT_EQ(curve.encode8(c, curve.decode(c, code)), code)
              << "curve " << int(kind) << " black " << black;
        }
    }
}

TEST(ResponseTable, EverySixteenBitCodeComesBack) {
  for (const Curve kind : kCurves)
    for (const float black : kBlacks) {
      const ResponseTable curve(table(kind, 16), black);
      ASSERT_EQ(curve.largest_code(), 65535U);
      unsigned wrong = 0, farthest = 0;
      for (unsigned code = 0; code < 65536; code += code < 4096 ? 1 : 7) {
        const unsigned back = curve.encode(1, curve.decode(1, code));
        const unsigned off = back > code ? back - code : code - back;
        // With a black level a float cannot hold the first codes of a steep curve: the sum rounds
        // them away.
        const unsigned allowed = black > 0 && code < 64 ? 8 : 0;
        wrong += off > allowed, farthest = std::max(farthest, off);
      }
      EXPECT_EQ(wrong, 0U) << "curve " << int(kind) << " black " << black << ": the farthest is "
                           << farthest << " codes off";
    }
}

TEST(ResponseTable, EncodesToTheNearestCode) {
  // The header allows a hundredth of a code (encode) and a tenth (encode8) beside the exact half.
  for (const Curve kind : kCurves)
    for (const int bits : {8, 16}) {
      const auto decode = table(kind, bits);
      const ResponseTable curve(decode, 0);
      double worst = 0, worst8 = 0, at = 0, at8 = 0;
      for (int i = 0; i <= 400000; ++i) {
        const auto x = static_cast<float>(std::pow(10., -6 + 6 * i / 400000.));
        const double exact = exact_code(decode[0], double(x));
        const double off = std::abs(double(curve.encode(0, x)) - exact);
        if (!(off <= worst)) worst = off, at = double(x);
        if (bits != 8) continue;
        const double off8 = std::abs(double(curve.encode8(0, x)) - exact);
        if (!(off8 <= worst8)) worst8 = off8, at8 = double(x);
      }
      EXPECT_LE(worst, .51) << "curve " << int(kind) << ", " << bits << " bit, at " << at;
      EXPECT_LE(worst8, .6) << "curve " << int(kind) << ", encode8, at " << at8;
    }
}

TEST(ResponseTable, BlackLevelIsTakenOffAndPutBack) {
  const ResponseTable curve(table(Curve::kLinear, 8), .1f);
  EXPECT_NEAR(curve.decode(0, 0), -.1, 1e-6) << "darker than black is negative, not 0";
  EXPECT_EQ(curve.encode(0, 0), 26U);  // .1 of 255, rounded
  EXPECT_EQ(curve.encode8(0, 0), 26);
  EXPECT_EQ(curve.encode(0, -.1f), 0U);
  EXPECT_EQ(curve.encode8(0, -.1f), 0);
}

TEST(ResponseTable, ClampsWhatIsOutOfRange) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  for (const Curve kind : kCurves)
    for (const int bits : {8, 16}) {
      const ResponseTable curve(table(kind, bits), .01f);
      for (const float high : {1.f, 2.f, 1e30f, kInfinity})
        EXPECT_EQ(curve.encode(0, high), curve.largest_code());
      for (const float low : {-.02f, -1e30f, -kInfinity}) EXPECT_EQ(curve.encode(0, low), 0U);
      if (bits != 8) continue;
      for (const float high : {1.f, 2.f, 1e30f, kInfinity}) EXPECT_EQ(curve.encode8(0, high), 255);
      for (const float low : {-.02f, -1e30f, -kInfinity}) EXPECT_EQ(curve.encode8(0, low), 0);
    }
}

TEST(ResponseTable, NanIsCodeZero) {
  for (const float nan :
       {std::numeric_limits<float>::quiet_NaN(), -std::numeric_limits<float>::quiet_NaN()}) {
    EXPECT_EQ(ResponseTable(table(Curve::kSrgb, 16), 0).encode(0, nan), 0U);
    const ResponseTable curve(table(Curve::kSrgb, 8), 0);
    EXPECT_EQ(curve.encode(0, nan), 0U);
    EXPECT_EQ(curve.encode8(0, nan), 0);
  }
}

TEST(ResponseTable, NeverFallsAsTheSignalRises) {
  for (const Curve kind : kCurves) {
    const ResponseTable c8(table(kind, 8), .01f), c16(table(kind, 16), .01f);
    unsigned last = 0, last8 = 0, last16 = 0;
    for (int i = -2000; i < 220000; ++i) {
      const float x = static_cast<float>(i) * 5e-6f;
      EXPECT_GE(c8.encode(0, x), last);
      EXPECT_GE(c8.encode8(0, x), last8);
      EXPECT_GE(c16.encode(0, x), last16);
      last = c8.encode(0, x), last8 = c8.encode8(0, x), last16 = c16.encode(0, x);
    }
  }
}

}  // namespace
}  // namespace penumbra
