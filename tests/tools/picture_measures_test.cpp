#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>

#include "tools/chart/measures/luminance_error.h"
#include "tools/chart/measures/picture_pairs.h"
#include "tools/chart/measures/sarnoff.h"

namespace penumbra::tools {
namespace {

Image<Rgb> grey(int width, int height, float v) {
  return Image<Rgb>(width, height, {v, v, v});
}

Image<Rgb> ramp(float added = 0) {
  Image<Rgb> out(101, 7);
  for (int y = 0; y < 7; ++y)
    for (int x = 0; x < 101; ++x) {
      const float v = static_cast<float>(x) / 100 + added;
      out.at(x, y) = {v, v, v};
    }
  return out;
}

// A tenth everywhere over a range of 1: a hundredth, and 20 dB.
TEST(LuminanceError, IsEquation44) {
  const auto error = luminance_error(ramp(), ramp(.1f));
  ASSERT_TRUE(error);
  EXPECT_NEAR(error->mse, .01, 1e-7);
  EXPECT_NEAR(error->psnr_db, 20, 1e-4);
  EXPECT_EQ(luminance_error(ramp(), ramp())->psnr_db, HUGE_VAL);
  // The range is the reference's: a hundred times the light is the same ratio.
  Image<Rgb> a = ramp(), b = ramp(.1f);
  for (Rgb& p : a.pixels()) p = 100 * p;
  for (Rgb& p : b.pixels()) p = 100 * p;
  EXPECT_NEAR(luminance_error(a, b)->psnr_db, 20, 1e-4);
}

TEST(LuminanceError, AColourCountsByItsLuminance) {
  Image<Rgb> green = grey(10, 10, 0), red = green;
  green.at(0, 0) = red.at(0, 0) = {1, 1, 1};
  for (int x = 0; x < 10; ++x) green.at(x, 5).g = 1, red.at(x, 5).r = 1;
  const Image<Rgb> none = [] {
    Image<Rgb> out = grey(10, 10, 0);
    out.at(0, 0) = {1, 1, 1};
    return out;
  }();
  EXPECT_NEAR(luminance_error(none, green)->mse, .1 * .7152 * .7152, 1e-6);
  EXPECT_NEAR(luminance_error(none, red)->mse, .1 * .2126 * .2126, 1e-6);
}

// The ends that the authors' encoder states for this variant, and what its scale is made for: 256
// at the 100 cd/m^2 of an ordinary display.
TEST(Pu21, HasThePublishedValues) {
  EXPECT_NEAR(pu21(.005), 5.4705e-10, 1e-7);
  EXPECT_NEAR(pu21(10000), 595.3939, 1e-4);
  EXPECT_NEAR(pu21(100), 256, .5);
  EXPECT_EQ(pu21(0), pu21(.005));
  EXPECT_EQ(pu21(1e9), pu21(10000));
  double last = -1;
  for (double l = .005; l < 1e4; l *= 1.1) {
    EXPECT_GT(pu21(l), last);
    last = pu21(l);
  }
}

TEST(Pu21, EvenPicturesHaveTheClosedForm) {
  const auto error = pu21_error(grey(40, 30, .2f), grey(40, 30, .5f), 200);
  ASSERT_TRUE(error);
  const double a = pu21(40), b = pu21(100), c1 = std::pow(.01 * 256, 2);
  EXPECT_NEAR(error->psnr_db, 20 * std::log10(256 / (b - a)), 1e-4);
  EXPECT_NEAR(error->ssim, (2 * a * b + c1) / (a * a + b * b + c1), 1e-6);
  for (const float d : error->difference.pixels()) ASSERT_NEAR(d, b - a, 1e-3);
  const auto same = pu21_error(ramp(), ramp(), 100);
  ASSERT_TRUE(same);
  EXPECT_EQ(same->psnr_db, HUGE_VAL);
  EXPECT_NEAR(same->ssim, 1, 1e-12);
}

// Stripes against their mirror image: the covariance is minus the variance.
TEST(Pu21, OppositeStripesAreDissimilar) {
  Image<Rgb> a(64, 64), b(64, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 64; ++x) {
      const float v = (x / 2) % 2 ? .9f : .1f, w = 1 - v;
      a.at(x, y) = {v, v, v}, b.at(x, y) = {w, w, w};
    }
  EXPECT_LT(pu21_error(a, b, 100)->ssim, -.8);
}

// By hand from the octaves of the table.
TEST(Sarnoff, WeightsAreThoseOfTheTable) {
  const auto weights = sarnoff_weights();
  EXPECT_NEAR(weights[2], 10 * (1 / 11. + 2 / 12.) / 3, 1e-12);
  EXPECT_NEAR(weights[1],
              10 *
                  (1 / 10. + 1 / 13. + 3 / 14. + 2 / 16. + 1 / 17. + 1 / 19. + 1 / 22. + 1 / 24. +
                   1 / 29.) /
                  12,
              1e-12);
  EXPECT_NEAR(weights[0], .176421, 1e-6);
}

TEST(Sarnoff, NothingDiffersFromItself) {
  const auto map = sarnoff_map(ramp(.1f), ramp(.1f));
  ASSERT_TRUE(map);
  EXPECT_EQ(mean_sarnoff(*map), 0);
}

TEST(Sarnoff, EvenBrightnessIsNoContrast) {
  const auto map = sarnoff_map(grey(50, 37, .2f), grey(50, 37, .7f));
  ASSERT_TRUE(map);
  for (const float v : map->pixels()) ASSERT_NEAR(v, 0, 1e-6);
}

// Lines of S-curve values m + .1 and m - .1 against even m: the coarser scales are even, and the
// finest holds each line's ratio to m.
TEST(Sarnoff, LinesHaveTheClosedForm) {
  constexpr double kExponent = .73, kShift = .1, kNothing = 1e-4;
  const double power = std::pow(.18, kExponent), m = power / (1 + power), light = .4;
  const auto luminance_of = [&](double s) {
    return static_cast<float>(std::pow(s / (1 - s), 1 / kExponent) * light / .18);
  };
  const float bright = luminance_of(m + kShift), dark = luminance_of(m - kShift);
  Image<Rgb> lines(64, 48);
  for (int y = 0; y < 48; ++y)
    for (int x = 0; x < 64; ++x) {
      const float v = y % 2 ? bright : dark;
      lines.at(x, y) = {v, v, v};
    }
  const auto map = sarnoff_map(grey(64, 48, static_cast<float>(light)), lines);
  ASSERT_TRUE(map);
  const auto expected = [&](double s) {
    const double c = (s + kNothing) / (s + m + 2 * kNothing);
    return sarnoff_weights()[0] * std::abs(c - .5);
  };
  for (int x = 0; x < 64; ++x) {
    ASSERT_NEAR(map->at(x, 20), expected(m - kShift), 1e-5);
    ASSERT_NEAR(map->at(x, 47), expected(m + kShift), 1e-5);
  }
  EXPECT_NEAR(mean_sarnoff(*map), (expected(m - kShift) + expected(m + kShift)) / 2, 1e-5);
}

// Noise of one strength: coarse noise is seen more than fine noise.
TEST(Sarnoff, CoarseErrorsCountMore) {
  const auto blocks = [](int side) {
    Image<Rgb> out(96, 96);
    for (int y = 0; y < 96; ++y)
      for (int x = 0; x < 96; ++x) {
        const float v = (x / side + y / side) % 2 ? .45f : .35f;
        out.at(x, y) = {v, v, v};
      }
    return out;
  };
  const auto fine = sarnoff_map(grey(96, 96, .4f), blocks(1)),
             coarse = sarnoff_map(grey(96, 96, .4f), blocks(4));
  ASSERT_TRUE(fine && coarse);
  EXPECT_GT(mean_sarnoff(*coarse), 1.3 * mean_sarnoff(*fine));
}

TEST(PicturePairs, OddSizesAreMeasured) {
  for (const auto& [width, height] : {std::pair{1, 1}, {1, 9}, {13, 1}, {2, 3}}) {
    const Image<Rgb> a = grey(width, height, .3f), b = grey(width, height, .4f);
    EXPECT_TRUE(sarnoff_map(a, b));
    EXPECT_TRUE(pu21_error(a, b, 100));
    EXPECT_TRUE(luminance_error(a, b));
  }
}

TEST(PicturePairs, WhatCannotBeComparedIsRefused) {
  const Image<Rgb> a = grey(5, 5, .3f), other = grey(5, 6, .3f);
  Image<Rgb> bad = a;
  bad.at(2, 3).b = std::numeric_limits<float>::quiet_NaN();
  EXPECT_EQ(sarnoff_map(a, other).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(pu21_error(a, bad, 100).error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(luminance_error(bad, a).error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(luminance_error({}, {}).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(pu21_error(a, a, 0).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(sarnoff_map(grey(5, 5, 0), a).error().code, ErrorCode::kUndetermined);
}

TEST(PicturePairs, HeatGoesFromBlackToWhite) {
  Image<float> error(5, 1);
  for (int x = 0; x < 5; ++x) error.at(x, 0) = static_cast<float>(x) / 3 - .001f;
  const Image<Rgb8> heat = heat_picture(error);
  EXPECT_EQ(heat.at(0, 0), (Rgb8{0, 0, 0}));
  EXPECT_EQ(heat.at(1, 0), (Rgb8{254, 0, 0}));
  EXPECT_EQ(heat.at(2, 0), (Rgb8{255, 254, 0}));
  EXPECT_EQ(heat.at(3, 0), (Rgb8{255, 255, 254}));
  EXPECT_EQ(heat.at(4, 0), (Rgb8{255, 255, 255}));
}

}  // namespace
}  // namespace penumbra::tools
