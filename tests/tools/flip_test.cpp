#include "tools/chart/measures/flip.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace penumbra::tools {

namespace {

constexpr int kWidth = 96, kHeight = 64;

Image<Rgb> uniform(float v) {
  return Image<Rgb>(kWidth, kHeight, {v, v, v});
}

// Coloured waves; `changed` dims the red, inverts the blue and sets a light on them.
Rgb wave(int x, int y, bool changed) {
  const auto fx = static_cast<float>(x), fy = static_cast<float>(y);
  Rgb p{.5f + .45f * std::sin(.21f * fx + .05f * fy),
        .5f + .45f * std::sin(.13f * fy - .04f * fx + 1), .5f + .45f * std::cos(.09f * (fx + fy))};
  if (!changed) return p;
  p.r *= .8f;
  p.b = 1 - p.b;
  return (x - 30) * (x - 30) + (y - 20) * (y - 20) < 60 ? Rgb{.9f, .9f, .9f} : p;
}

Image<Rgb> waves(bool changed) {
  Image<Rgb> out(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) out.at(x, y) = wave(x, y, changed);
  return out;
}

// The same under light that spans 5 decades.
Image<Rgb> bright_waves(bool changed, float scale = 1) {
  Image<Rgb> out = waves(changed);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      out.at(x, y) = scale * out.at(x, y) *
                     std::exp(6 * std::sin(.07f * static_cast<float>(x)) *
                              std::cos(.05f * static_cast<float>(y)));
  return out;
}

float largest(const Image<float>& map) {
  return *std::max_element(map.pixels().begin(), map.pixels().end());
}

void expect_within_unit(const Image<float>& map) {
  for (const float v : map.pixels()) ASSERT_TRUE(v >= 0 && v <= 1) << v;
}

TEST(Flip, IdenticalPicturesDoNotDiffer) {
  EXPECT_EQ(largest(flip(waves(true), waves(true))), 0);
  const auto hdr = hdr_flip(bright_waves(true), bright_waves(true));
  ASSERT_TRUE(hdr);
  EXPECT_EQ(largest(*hdr), 0);
}

// Without edges FLIP is the colour term alone. From the tabulated CIELAB of the sRGB primaries:
// black and white are 100 apart, and the largest distance is that of green and blue.
TEST(Flip, BlackAgainstWhiteIsTheClosedForm) {
  const double green[3] = {87.7347, -86.1827, 83.1793}, blue[3] = {32.2970, 79.1875, -107.8602};
  double chroma[2];
  for (int k = 0; k < 2; ++k)
    chroma[k] = .01 * (green[0] * green[k + 1] - blue[0] * blue[k + 1]);  // Hunt effect
  const double limit = std::pow(green[0] - blue[0] + std::hypot(chroma[0], chroma[1]), .7);
  const double expected = .95 + .05 * (std::pow(100, .7) - .4 * limit) / (.6 * limit);
  const Image<float> map = flip(uniform(0), uniform(1));
  for (const float v : map.pixels()) ASSERT_NEAR(v, expected, 2e-5);
  EXPECT_NEAR(expected, .967, .001);
}

// What the authors' own program (FLIP 1.6) gives for these pictures.
TEST(Flip, AgreesWithTheAuthorsProgram) {
  const Image<float> map = flip(waves(false), waves(true));
  EXPECT_NEAR(mean_flip(map), .754963, 5e-5);
  EXPECT_NEAR(map.at(0, 0), .961730, 2e-4);
  EXPECT_NEAR(map.at(37, 20), .290541, 2e-4);
  EXPECT_NEAR(mean_flip(flip(waves(false), waves(true), 20)), .758049, 5e-5);
  const auto hdr = hdr_flip(bright_waves(false), bright_waves(true));
  ASSERT_TRUE(hdr);
  EXPECT_NEAR(mean_flip(*hdr), .556030, 5e-5);
  EXPECT_NEAR(hdr->at(48, 33), .586596, 2e-4);
}

TEST(Flip, IsSymmetricAndWithinUnit) {
  const Image<float> there = flip(waves(false), waves(true)),
                     back = flip(waves(true), waves(false));
  expect_within_unit(there);
  for (std::size_t i = 0; i < there.area(); ++i)
    ASSERT_FLOAT_EQ(there.pixels()[i], back.pixels()[i]);
  // Full-contrast noise drives both terms to their ends.
  Image<Rgb> noise(kWidth, kHeight), inverse(kWidth, kHeight);
  unsigned state = 7;
  for (std::size_t i = 0; i < noise.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      state = state * 1664525u + 1013904223u;
      noise.pixels()[i][c] = state >> 31 ? 1.f : 0.f;
      inverse.pixels()[i][c] = 1 - noise.pixels()[i][c];
    }
  expect_within_unit(flip(noise, inverse, 10));
  expect_within_unit(flip(noise, inverse, 1));
}

TEST(Flip, LargerDifferenceGivesLargerValue) {
  double last = 0;
  for (const float v : {.41f, .45f, .5f, .6f, .8f, 1.f}) {
    const double now = mean_flip(flip(uniform(.4f), uniform(v)));
    EXPECT_GT(now, last) << v;
    last = now;
  }
}

TEST(Flip, ValuesBeyondTheDisplayAreClipped) {
  EXPECT_EQ(largest(flip(uniform(1), uniform(9))), 0);
  EXPECT_EQ(largest(flip(uniform(0), uniform(-9))), 0);
}

TEST(Flip, MovedPointIsSeenAtBothPlacesOnly) {
  Image<Rgb> a = uniform(.2f), b = uniform(.2f);
  const auto dot = [](Image<Rgb>& image, int x) {
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) image.at(x + dx, 32 + dy) = {.7f, .7f, .7f};
  };
  dot(a, 30);
  dot(b, 65);
  const Image<float> map = flip(a, b);
  EXPECT_GT(map.at(30, 32), .5);
  EXPECT_GT(map.at(65, 32), .5);
  EXPECT_LT(map.at(47, 32), 1e-3);
  EXPECT_LT(map.at(30, 60), 1e-3);
}

// A checkerboard finer than the eye resolves is its mean, where both are far from edges.
TEST(Flip, DetailBeyondResolutionCountsLittle) {
  Image<Rgb> fine(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      fine.at(x, y) = (x + y) % 2 ? Rgb{.6f, .6f, .6f} : Rgb{.4f, .4f, .4f};
  const double far = mean_flip(flip(uniform(.5f), fine, 200)),
               near = mean_flip(flip(uniform(.5f), fine, 5));
  EXPECT_LT(far, .03);
  EXPECT_GT(near, .3);
}

TEST(HdrFlip, OneFactorOnBothPicturesChangesNothing) {
  const auto base = hdr_flip(bright_waves(false), bright_waves(true));
  ASSERT_TRUE(base);
  for (const float scale : {1e-4f, .37f, 5e3f}) {
    const auto scaled = hdr_flip(bright_waves(false, scale), bright_waves(true, scale));
    ASSERT_TRUE(scaled);
    for (std::size_t i = 0; i < base->area(); ++i)
      ASSERT_NEAR(base->pixels()[i], scaled->pixels()[i], 1e-3) << scale;
  }
}

TEST(HdrFlip, FindsWhatClippingHides) {
  Image<Rgb> a = uniform(.5f), b = uniform(.5f);
  for (int y = 20; y < 40; ++y)
    for (int x = 30; x < 50; ++x) a.at(x, y) = {400, 400, 400}, b.at(x, y) = {40, 40, 40};
  EXPECT_EQ(largest(flip(a, b)), 0);
  const auto map = hdr_flip(a, b);
  ASSERT_TRUE(map);
  expect_within_unit(*map);
  EXPECT_GT(map->at(40, 30), .5);
  EXPECT_LT(map->at(5, 5), 1e-3);
}

TEST(HdrFlip, FindsWhatDarknessHides) {
  Image<Rgb> a = uniform(.001f), b = uniform(.001f);
  a.at(3, 3) = b.at(3, 3) = {1, 1, 1};
  for (int y = 20; y < 40; ++y)
    for (int x = 30; x < 50; ++x) b.at(x, y) = {.0004f, .0004f, .0004f};
  const auto map = hdr_flip(a, b);
  ASSERT_TRUE(map);
  EXPECT_GT(map->at(40, 30), 3 * flip(a, b).at(40, 30));
}

TEST(HdrFlip, MostlyBlackReferenceIsExposedForItsOtherPixels) {
  Image<Rgb> a = uniform(0), b = uniform(0);
  for (int y = 20; y < 40; ++y)
    for (int x = 30; x < 50; ++x) a.at(x, y) = {3, 3, 3}, b.at(x, y) = {2, 2, 2};
  const auto map = hdr_flip(a, b);
  ASSERT_TRUE(map);
  expect_within_unit(*map);
  EXPECT_GT(map->at(40, 30), .05);
}

TEST(HdrFlip, ExtremeButFiniteRadianceStaysWithinUnit) {
  Image<Rgb> a(16, 12, {1e-40f, 1e-40f, 1e-40f}), b(16, 12, {-3, -3, -3});
  a.at(1, 1) = {3e38f, 3e38f, 3e38f};
  b.at(2, 2) = {3e38f, 0, 3e38f};
  const auto map = hdr_flip(a, b);
  ASSERT_TRUE(map);
  expect_within_unit(*map);
}

TEST(HdrFlip, RefusesWhatItCannotCompare) {
  const Image<Rgb> good = uniform(1);
  EXPECT_EQ(hdr_flip(good, Image<Rgb>(kWidth, kHeight - 1)).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(hdr_flip({}, {}).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(hdr_flip(good, good, .5).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(hdr_flip(good, good, std::nan("")).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(hdr_flip(uniform(0), good).error().code, ErrorCode::kUndetermined);
  Image<Rgb> bad = good;
  bad.at(5, 6).g = std::numeric_limits<float>::quiet_NaN();
  const auto in_test = hdr_flip(good, bad);
  EXPECT_EQ(in_test.error().code, ErrorCode::kNonFinite);
  EXPECT_NE(in_test.error().detail.find("(5, 6)"), std::string::npos) << in_test.error().detail;
  bad.at(5, 6).g = std::numeric_limits<float>::infinity();
  EXPECT_EQ(hdr_flip(bad, good).error().code, ErrorCode::kNonFinite);
}

TEST(MeanFlip, IsTheMean) {
  Image<float> map(2, 1);
  map.at(1, 0) = .5f;
  EXPECT_EQ(mean_flip(map), .25);
  EXPECT_EQ(mean_flip({}), 0);
}

}  // namespace
}  // namespace penumbra::tools
