#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "codec/tone/layers.h"
#include "codec/tone/tone_mapping.h"

namespace penumbra::tone {
namespace {

constexpr double kRange = 10;

Image<float> grainy(int width, int height, float amplitude) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<float> grain(-amplitude, amplitude);
  Image<float> out(width, height);
  for (float& v : out.pixels()) v = grain(rng);
  return out;
}

// Rooms of very different light, with waves and grain.
Image<float> rooms(int width, int height) {
  Image<float> out = grainy(width, height, .3f);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      out.at(x, y) += static_cast<float>((x / 24 + 3 * (y / 20)) % 5) * 2 - 4 +
                      .4f * std::sin(.3f * static_cast<float>(x + 2 * y));
  return out;
}

// A step of one height across a line through the middle.
Image<float> step_edge(double degrees, float height) {
  Image<float> out(64, 64);
  const double c = std::cos(degrees * std::numbers::pi / 180),
               s = std::sin(degrees * std::numbers::pi / 180);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) out.at(x, y) = (x - 31.5) * c + (y - 31.5) * s > 0 ? height : 0.f;
  return out;
}

double largest_difference(const Image<float>& a, const Image<float>& b) {
  double out = 0;
  for (std::size_t i = 0; i < a.area(); ++i)
    out = std::max<double>(out, std::abs(a.pixels()[i] - b.pixels()[i]));
  return out;
}

// Least and largest around each pixel, `reach` pixels far.
void expect_between_neighbours(const Image<float>& picture, const Image<float>& base, int reach) {
  for (int y = 0; y < picture.height(); ++y)
    for (int x = 0; x < picture.width(); ++x) {
      float low = HUGE_VALF, high = -HUGE_VALF;
      for (int v = std::max(0, y - reach); v <= std::min(picture.height() - 1, y + reach); ++v)
        for (int u = std::max(0, x - reach); u <= std::min(picture.width() - 1, x + reach); ++u)
          low = std::min(low, picture.at(u, v)), high = std::max(high, picture.at(u, v));
      ASSERT_TRUE(base.at(x, y) >= low - 1e-5f && base.at(x, y) <= high + 1e-5f) << x << ' ' << y;
    }
}

TEST(LevelSet, WithoutStepsAPictureIsItsProfile) {
  const Image<float> picture = rooms(70, 50);
  EXPECT_EQ(level_set_profile(picture, kRange, {.steps = 0}).value(), picture);
}

TEST(LevelSet, AConstantPictureHasNoDetail) {
  for (const float v : {-40.f, 0.f, 1.234567f, 30.f})
    EXPECT_EQ(level_set_profile(Image<float>(37, 41, v), kRange).value(), Image<float>(37, 41, v))
        << v;
}

// A faint wave has neither slope nor edge: the flow is that of heat, whose five-point scheme takes
// from each step 4 sin^2(k/2) dt of the wave.
TEST(LevelSet, AFaintWaveDecaysAsHeat) {
  constexpr int kWidth = 128;
  const double k = 2 * std::numbers::pi * 8 / kWidth, step = .12;
  Image<float> wave(kWidth, 16);
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < kWidth; ++x)
      wave.at(x, y) = static_cast<float>(1e-3 * std::cos(k * (x + .5)));
  const auto profile = level_set_profile(wave, kRange, {.steps = 20, .time_step = step});
  ASSERT_TRUE(profile);
  const double left = std::pow(1 - 4 * std::pow(std::sin(k / 2), 2) * step, 20);
  ASSERT_LT(left, .75);
  for (int x = 0; x < kWidth; ++x) ASSERT_NEAR(profile->at(x, 7), left * wave.at(x, 7), 1e-6) << x;
}

// The longer way: equation 3.4 with F of 3.6, in double precision and without clamps.
double changed(const Image<double>& in, int x, int y, double scale, double sensitivity) {
  const auto at = [&](int dx, int dy) {
    return scale *
           in.at(std::clamp(x + dx, 0, in.width() - 1), std::clamp(y + dy, 0, in.height() - 1));
  };
  const double ix = (at(1, 0) - at(-1, 0)) / 2, iy = (at(0, 1) - at(0, -1)) / 2;
  const double xx = at(1, 0) - 2 * at(0, 0) + at(-1, 0), yy = at(0, 1) - 2 * at(0, 0) + at(0, -1);
  const double xy = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4;
  const double slope2 = 1 + ix * ix + iy * iy;
  const double curvature =
      ((1 + iy * iy) * xx - 2 * ix * iy * xy + (1 + ix * ix) * yy) / std::pow(slope2, 1.5);
  const double edge = std::exp(-sensitivity * std::sqrt(xx * xx + yy * yy + 2 * xy * xy));
  return edge * curvature * std::sqrt(slope2) / scale;
}

TEST(LevelSet, FollowsTheEquationOfTheSurface) {
  const Image<float> smooth = [] {
    Image<float> out(90, 150);
    for (int y = 0; y < 150; ++y)
      for (int x = 0; x < 90; ++x)
        out.at(x, y) = static_cast<float>(2 * std::sin(.21 * x) * std::cos(.13 * y) + .03 * x);
    return out;
  }();
  for (const double range : {4., 10., 17.}) {
    Image<double> expected(90, 150);
    std::ranges::copy(smooth.pixels(), expected.pixels().begin());
    for (int k = 0; k < 5; ++k) {
      Image<double> next = expected;
      for (int y = 0; y < 150; ++y)
        for (int x = 0; x < 90; ++x) next.at(x, y) += .12 * changed(expected, x, y, 10 / range, 8);
      expected = next;
    }
    const auto profile = level_set_profile(smooth, range, {.steps = 5});
    ASSERT_TRUE(profile);
    double largest = 0;
    for (std::size_t i = 0; i < smooth.area(); ++i)
      largest = std::max(largest, std::abs(profile->pixels()[i] - expected.pixels()[i]));
    EXPECT_LT(largest, 2e-5) << range;
    EXPECT_GT(largest_difference(*profile, smooth), 2e-3) << range;
  }
}

TEST(LevelSet, NoTimeStepMakesItUnstable) {
  const Image<float> picture = rooms(70, 50);
  const auto [low, high] = std::ranges::minmax(picture.pixels());
  for (const double step : {1e-3, .12, .5, 3., 100.})
    for (const double sensitivity : {0., 8.}) {
      const auto profile = level_set_profile(
          picture, kRange, {.steps = 12, .time_step = step, .sensitivity = sensitivity});
      ASSERT_TRUE(profile);
      for (const float v : profile->pixels()) ASSERT_TRUE(v >= low && v <= high) << step;
    }
}

TEST(LevelSet, OneStepStaysBetweenTheNeighbours) {
  const Image<float> picture = rooms(70, 50);
  const auto profile =
      level_set_profile(picture, kRange, {.steps = 1, .time_step = .25, .sensitivity = 0});
  ASSERT_TRUE(profile);
  expect_between_neighbours(picture, *profile, 1);
}

TEST(LevelSet, LongStepsAreManyShortOnes) {
  const Image<float> picture = rooms(70, 50);
  EXPECT_EQ(level_set_profile(picture, kRange, {.steps = 2, .time_step = 1}).value(),
            level_set_profile(picture, kRange, {.steps = 8, .time_step = .25}).value());
}

// As many rows as make one strip or several, and widths that hang over vectors.
TEST(LevelSet, StripsAndVectorsLeaveNoTrace) {
  const Image<float> picture = rooms(150, 300);
  const auto whole = level_set_profile(picture, kRange, {.steps = 15});
  ASSERT_TRUE(whole);
  for (const int x0 : {0, 37}) {
    Image<float> part(149 - x0 - 6, 200);
    for (int y = 0; y < part.height(); ++y)
      for (int x = 0; x < part.width(); ++x) part.at(x, y) = picture.at(x + x0, y + 60);
    const auto alone = level_set_profile(part, kRange, {.steps = 15});
    ASSERT_TRUE(alone);
    for (int y = 15; y < part.height() - 15; ++y)
      for (int x = 15; x < part.width() - 15; ++x)
        ASSERT_EQ(alone->at(x, y), whole->at(x + x0, y + 60)) << x << ' ' << y;
  }
}

TEST(LevelSet, TheHaloAtAnEdgeIsBounded) {
  for (const double range : {5., 10., 20.})
    for (const double degrees : {0., 90., 45., 30.})
      for (const float height : {.05f, .125f, .3f, 1.f, 4.f}) {
        const Image<float> edge = step_edge(degrees, height * static_cast<float>(range / 10));
        const auto profile = level_set_profile(edge, range);
        ASSERT_TRUE(profile);
        const double halo = largest_difference(*profile, edge);
        EXPECT_LE(halo, level_set_bound(range)) << degrees << ' ' << height;
        if (height >= 1) {
          EXPECT_LE(halo, 1e-3 * range) << degrees << ' ' << height;
        }
      }
  EXPECT_NEAR(level_set_bound(10), std::sqrt(2.) * 1.8 / (std::exp(1.) * 8), 1e-12);
  EXPECT_EQ(level_set_bound(10, {.sensitivity = 0}), HUGE_VAL);
}

TEST(LevelSet, NoDetailExceedsTheBound) {
  for (const int steps : {1, 15, 50}) {
    const Image<float> picture = rooms(120, 90);
    const auto profile = level_set_profile(picture, kRange, {.steps = steps});
    ASSERT_TRUE(profile);
    EXPECT_LE(largest_difference(*profile, picture), level_set_bound(kRange, {.steps = steps}));
  }
}

TEST(LevelSet, MoreStepsTakeMoreDetail) {
  const Image<float> picture = rooms(120, 90);
  double last = 0;
  for (const int steps : {0, 3, 7, 14, 50}) {
    const auto profile = level_set_profile(picture, kRange, {.steps = steps});
    ASSERT_TRUE(profile);
    double energy = 0;
    for (std::size_t i = 0; i < picture.area(); ++i)
      energy += std::pow(picture.pixels()[i] - profile->pixels()[i], 2);
    EXPECT_TRUE(steps == 0 ? energy == 0 : energy > last) << steps;
    last = energy;
  }
}

TEST(LevelSet, BadOptionsAndValuesAreRefused) {
  const Image<float> picture = rooms(8, 8);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const LevelSetOptions& o :
       {LevelSetOptions{.steps = -1}, LevelSetOptions{.steps = 1001},
        LevelSetOptions{.time_step = 0}, LevelSetOptions{.time_step = nan},
        LevelSetOptions{.time_step = 101}, LevelSetOptions{.sensitivity = -1}}) {
    const auto refused = level_set_profile(picture, kRange, o);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  }
  EXPECT_FALSE(level_set_profile(picture, 0));
  Image<float> damaged = picture;
  damaged.at(3, 5) = std::numeric_limits<float>::infinity();
  const auto refused = level_set_profile(damaged, kRange);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kNonFinite);
  EXPECT_NE(refused.error().detail.find("(3, 5)"), std::string::npos);
}

TEST(Bilateral, AConstantPictureHasNoDetail) {
  for (const float v : {-40.f, 0.f, 1.234567f})
    EXPECT_EQ(bilateral_base(Image<float>(50, 30, v), {.sigma_px = 6}).value(),
              Image<float>(50, 30, v));
}

TEST(Bilateral, StaysBetweenTheSmallestAndTheLargest) {
  const Image<float> picture = rooms(90, 70);
  const auto [low, high] = std::ranges::minmax(picture.pixels());
  const auto base = bilateral_base(picture, {.sigma_px = 5});
  ASSERT_TRUE(base);
  for (const float v : base->pixels()) ASSERT_TRUE(v >= low - 1e-5f && v <= high + 1e-5f);
}

// What is 4 sigma apart does not mix, so an edge that high is kept to the bit of its sums.
TEST(Bilateral, ThereIsNoHaloAtALargeEdge) {
  for (const double degrees : {0., 90., 45.}) {
    const Image<float> edge = step_edge(degrees, 4);
    const auto base = bilateral_base(edge, {.sigma_px = 8, .sigma_range = .9});
    ASSERT_TRUE(base);
    EXPECT_LT(largest_difference(*base, edge), 1e-5);
  }
}

// The definition: Gaussian weights of place and value, over all pixels.
Image<float> bilateral_by_definition(const Image<float>& in, double sigma_px, double sigma) {
  Image<float> out(in.width(), in.height());
  for (int y = 0; y < in.height(); ++y)
    for (int x = 0; x < in.width(); ++x) {
      double sum = 0, weight = 0;
      for (int v = 0; v < in.height(); ++v)
        for (int u = 0; u < in.width(); ++u) {
          const double d2 = (u - x) * (u - x) + (v - y) * (v - y);
          const double r = in.at(u, v) - in.at(x, y);
          const double w = std::exp(-d2 / (2 * sigma_px * sigma_px) - r * r / (2 * sigma * sigma));
          sum += w * in.at(u, v), weight += w;
        }
      out.at(x, y) = static_cast<float>(sum / weight);
    }
  return out;
}

TEST(Bilateral, TheGridAgreesWithTheDefinition) {
  const Image<float> picture = rooms(72, 60);
  const auto base = bilateral_base(picture, {.sigma_px = 6, .sigma_range = .9});
  ASSERT_TRUE(base);
  const Image<float> expected = bilateral_by_definition(picture, 6, .9);
  double square = 0, detail = 0;
  for (std::size_t i = 0; i < picture.area(); ++i) {
    square += std::pow(base->pixels()[i] - expected.pixels()[i], 2);
    detail += std::pow(picture.pixels()[i] - expected.pixels()[i], 2);
  }
  EXPECT_LT(std::sqrt(square / detail), .25);
  EXPECT_GT(detail, 0);
}

TEST(Bilateral, BadOptionsAreRefused) {
  const Image<float> picture = rooms(40, 40);
  EXPECT_FALSE(bilateral_base(picture, {.sigma_px = 1}));
  EXPECT_FALSE(bilateral_base(picture, {.sigma_range = 0}));
  Image<float> damaged = picture;
  damaged.at(0, 1) = std::numeric_limits<float>::quiet_NaN();
  const auto refused = bilateral_base(damaged, {});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kNonFinite);
  // A small sigma on a large picture of a wide range would take gigabytes.
  Image<float> large(6000, 6000);
  large.at(0, 0) = 80;
  EXPECT_EQ(bilateral_base(large, {.sigma_px = 4}).error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::tone
