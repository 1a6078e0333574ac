#include "codec/log/log_luv.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace penumbra::codec {
namespace {

std::vector<Rgb> through_codes(const std::vector<Rgb>& values) {
  std::array<std::vector<std::uint16_t>, 3> planes;
  for (auto& plane : planes) plane.resize(values.size());
  log_luv_from_rgb(values, {planes[0], planes[1], planes[2]});
  for (const auto& plane : planes)
    for (const std::uint16_t code : plane) EXPECT_LT(code, 1 << kLogLuvBits);
  std::vector<Rgb> out(values.size());
  rgb_from_log_luv({planes[0], planes[1], planes[2]}, out);
  return out;
}

float brightness(const Rgb& p) {
  return .2126f * p.r + .7152f * p.g + .0722f * p.b;
}

// Twenty stops, all hues: relative errors above the toe, fractions of the toe below.
TEST(LogLuv, ErrorsAreRelativeAboveTheToe) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> stops(-10, 20), channel(.02f, 1);
  std::vector<Rgb> values;
  for (int i = 0; i < 20'000; ++i) {
    const float scale = std::exp2(stops(random));
    values.push_back({scale * channel(random), scale * channel(random), scale * channel(random)});
  }
  const auto back = through_codes(values);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const float y = brightness(values[i]) + kLogLuvToe;
    EXPECT_NEAR(brightness(back[i]), brightness(values[i]), .004f * y) << i;
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(back[i][c], values[i][c], .012f * (y + values[i][c])) << i << " " << c;
  }
}

TEST(LogLuv, BlackStaysBlackAndNoNumberIsBlack) {
  const float nan = std::numeric_limits<float>::quiet_NaN(),
              inf = std::numeric_limits<float>::infinity();
  const auto back = through_codes(
      {{0, 0, 0}, {-1, -5, -.1f}, {nan, nan, nan}, {inf, inf, inf}, {1e38f, 1e38f, 1e38f}});
  for (int i = 0; i < 3; ++i)
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(back[i][c], 0, 1e-4f) << i;
  for (int i = 3; i < 5; ++i)
    for (int c = 0; c < 3; ++c) {
      EXPECT_TRUE(std::isfinite(back[i][c])) << i;
      EXPECT_GT(back[i][c], 1e7f) << i;
    }
}

TEST(LogLuv, AnyCodesGiveFiniteRadiance) {
  std::mt19937 random(2);
  std::array<std::vector<std::uint16_t>, 3> planes;
  for (auto& plane : planes)
    for (int i = 0; i < 4096; ++i) plane.push_back(static_cast<std::uint16_t>(random()));
  std::vector<Rgb> out(4096);
  rgb_from_log_luv({planes[0], planes[1], planes[2]}, out);
  for (const Rgb& p : out)
    for (int c = 0; c < 3; ++c) {
      EXPECT_TRUE(std::isfinite(p[c]));
      EXPECT_GE(p[c], 0);
    }
}

}  // namespace
}  // namespace penumbra::codec
