#include "codec/dct/rgbe_still.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "codec/dct/dct_coding.h"
#include "core/io/hash.h"

namespace penumbra::codec {

namespace {

// A slope over four stops, whose exponents step, with texture; odd sides, and a black corner.
Image<Rgb> textured_slope() {
  Image<Rgb> out(61, 45);
  for (int y = 0; y < out.height(); ++y)
    for (int x = 0; x < out.width(); ++x) {
      const auto v = static_cast<float>(std::exp2(x / 15.) * (1 + .1 * std::sin(.7 * x + .4 * y)));
      out.at(x, y) = x < 5 && y < 5 ? Rgb{} : Rgb{v, .7f * v, .4f * v};
    }
  return out;
}

RgbeCoding of_quality(RgbeBase base, int quality) {
  return {base, static_cast<int>(std::lround(64 * table_scale(quality)))};
}

Image<Rgb> back_from(const Image<Rgb>& truth, const RgbeCoding& coding) {
  const auto coded = encode_rgbe_still_as(truth, coding);
  EXPECT_TRUE(coded) << coded.error().detail;
  const auto is = decode_rgbe_still(coded->bytes, "test");
  EXPECT_TRUE(is) << is.error().detail;
  return is->pixels;
}

double relative_rms(const Image<Rgb>& truth, const Image<Rgb>& is) {
  double sum = 0;
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const Rgb& t = truth.pixels()[i];
      if (t.r > 0) sum += std::pow((is.pixels()[i][c] - t[c]) / t.r, 2);
    }
  return std::sqrt(sum / (3. * static_cast<double>(truth.area())));
}

// As a file that says so of itself.
void sign(std::vector<unsigned char>& file) {
  const std::uint64_t sum = Fnv1a().add(file.data() + 16, file.size() - 16).value();
  std::memcpy(file.data() + 8, &sum, sizeof sum);
}

TEST(RgbeStill, WithoutLossEveryCodeComesBack) {
  const Image<Rgb> truth = textured_slope();
  const auto coded = encode_rgbe_still_as(truth, {RgbeBase::kLossless});
  ASSERT_TRUE(coded) << coded.error().detail;
  const Image<Rgb> is = decode_rgbe_still(coded->bytes, "test")->pixels;
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c)  // half a step of eight bits, of which the largest uses half
      ASSERT_LE(std::abs(is.pixels()[i][c] - truth.pixels()[i][c]), truth.pixels()[i].r / 256) << i;
  EXPECT_EQ(is.at(2, 2), Rgb{});
  // What stands for a code is that code again.
  EXPECT_EQ(back_from(is, {RgbeBase::kLossless}), is);
  EXPECT_LT(coded->bytes.size(), 3 * truth.area());
}

TEST(RgbeStill, FinerStepsAreLargerAndNearer) {
  const Image<Rgb> truth = textured_slope();
  for (const RgbeBase base : {RgbeBase::kAdaptiveJpeg, RgbeBase::kContinuous}) {
    double before = 1;
    std::size_t size = 0;
    for (const int quality : {10, 50, 80, 95}) {
      const auto coded = encode_rgbe_still_as(truth, of_quality(base, quality));
      ASSERT_TRUE(coded);
      const double error = relative_rms(truth, decode_rgbe_still(coded->bytes, "test")->pixels);
      EXPECT_LT(error, before) << quality;
      EXPECT_GT(coded->bytes.size(), size);
      before = error, size = coded->bytes.size();
    }
    EXPECT_LT(before, .035);  // colours at half resolution
  }
}

// Figure 4.6 (e) and (f): a base that falls from 255 to 128 where the light goes on is an edge to
// the cosines, and their error there is one of the larger value.
TEST(RgbeStill, OneTableOfStepsRingsWhereExponentsStep) {
  const Image<Rgb> truth = textured_slope();
  const auto error_at_50 = [&](RgbeBase base) {
    return relative_rms(truth, back_from(truth, of_quality(base, 50)));
  };
  EXPECT_LT(error_at_50(RgbeBase::kAdaptiveJpeg), .85 * error_at_50(RgbeBase::kJpeg));
}

TEST(RgbeStill, ABaseThatGoesOnTakesHalfTheBytes) {
  const Image<Rgb> truth = textured_slope();
  const StillGoal goal{.deviation = std::log10(1.03)};
  const auto adaptive = encode_rgbe_still(truth, goal, RgbeBase::kAdaptiveJpeg);
  const auto continuous = encode_rgbe_still(truth, goal);
  ASSERT_TRUE(adaptive && continuous);
  for (const auto& coded : {adaptive, continuous}) {
    EXPECT_LE(coded->error.larger(), goal.deviation);
    EXPECT_GT(coded->error.larger(), .9 * goal.deviation);
  }
  EXPECT_LT(2 * continuous->bytes.size(), adaptive->bytes.size());
}

TEST(RgbeStill, ExponentsComeBackWithoutLoss) {
  const Image<Rgb> truth = textured_slope();
  const Image<Rgb> is = back_from(truth, {RgbeBase::kContinuous, 8000});  // two stops a step
  for (std::size_t i = 0; i < truth.area(); ++i) {
    const Rgb &a = truth.pixels()[i], &b = is.pixels()[i];
    EXPECT_EQ(std::ilogb(std::max({a.r, a.g, a.b})), std::ilogb(std::max({b.r, b.g, b.b}))) << i;
  }
}

TEST(RgbeStill, ASizeIsKept) {
  const Image<Rgb> truth = textured_slope();
  double before = 1;
  for (const std::size_t bytes : {300u, 600u, 1200u}) {
    const auto coded = encode_rgbe_still(truth, {.max_bytes = bytes});
    ASSERT_TRUE(coded) << bytes;
    EXPECT_LE(coded->bytes.size(), bytes);
    EXPECT_GT(coded->bytes.size(), bytes * 4 / 5);
    EXPECT_LT(coded->error.larger(), before);
    before = coded->error.larger();
  }
  EXPECT_FALSE(encode_rgbe_still(truth, {.max_bytes = 40}));
}

// A lamp of one pixel, in colour, on what is nearly black.
TEST(RgbeStill, ASmallLampKeepsItsLight) {
  Image<Rgb> truth(64, 32, Rgb{.001f, .001f, .001f});
  truth.at(21, 13) = {9000, 4000, 500};
  const auto coded = encode_rgbe_still(truth, {.deviation = std::log10(1.02)});
  ASSERT_TRUE(coded) << coded.error().detail;
  EXPECT_LE(coded->error.light, std::log10(1.02));
}

TEST(RgbeStill, EveryRangeAndSizeComesBack) {
  for (const auto& [width, height] : {std::pair{1, 1}, {1, 9}, {9, 1}, {8, 8}, {17, 3}})
    for (const float level : {0.f, 1e-30f, 1.f, 1e29f})
      for (const RgbeCoding& coding :
           {RgbeCoding{RgbeBase::kLossless}, {RgbeBase::kContinuous, 64}, {RgbeBase::kJpeg, 64}}) {
        const Image<Rgb> is =
            back_from(Image<Rgb>(width, height, Rgb{level, level, level}), coding);
        ASSERT_EQ(is.width(), width);
        for (const Rgb& p : is.pixels()) EXPECT_NEAR(p.g, level, .02f * level);
      }
}

TEST(RgbeStill, NegativesComeBackAtTheirLuminance) {
  const Image<Rgb> truth(16, 16, Rgb{1, -.1f, .5f});
  const auto coded = encode_rgbe_still(truth, {.deviation = std::log10(1.02)});
  ASSERT_TRUE(coded);
  EXPECT_EQ(coded->error.negative, truth.area());
  const Rgb is = decode_rgbe_still(coded->bytes, "test")->pixels.at(3, 3);
  EXPECT_NEAR(luminance(is), luminance(truth.at(3, 3)), .02 * luminance(is));
}

TEST(RgbeStill, TheProjectionIsKept) {
  const auto coded =
      encode_rgbe_still_as(textured_slope(), {RgbeBase::kLossless}, EnvironmentAttribute::kLatLong);
  ASSERT_TRUE(coded);
  EXPECT_EQ(decode_rgbe_still(coded->bytes, "test")->environment, EnvironmentAttribute::kLatLong);
}

TEST(RgbeStill, BadInputIsRefused) {
  EXPECT_FALSE(encode_rgbe_still({}));
  Image<Rgb> picture = textured_slope();
  EXPECT_FALSE(encode_rgbe_still_as(picture, {RgbeBase::kJpeg, 0}));
  EXPECT_FALSE(encode_rgbe_still(picture, {}, RgbeBase::kLossless));
  for (const float wrong :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e31f}) {
    picture.at(3, 4).g = wrong;
    const auto coded = encode_rgbe_still(picture);
    ASSERT_FALSE(coded);
    EXPECT_EQ(coded.error().where, "pixel 3, 4");
  }
}

TEST(RgbeStill, DamageIsFoundAndEndsNothing) {
  const Image<Rgb> picture = textured_slope();
  std::mt19937 random(5);
  for (const RgbeCoding& coding : {RgbeCoding{RgbeBase::kLossless},
                                   {RgbeBase::kContinuous, 100},
                                   {RgbeBase::kAdaptiveJpeg, 50}}) {
    const auto bytes = encode_rgbe_still_as(picture, coding)->bytes;
    for (std::size_t cut = 0; cut < bytes.size(); cut += 17)
      EXPECT_FALSE(decode_rgbe_still(std::span(bytes).first(cut), "cut")) << cut;
    for (int i = 0; i < 100; ++i) {
      auto wrong = bytes;
      wrong[random() % wrong.size()] ^= static_cast<unsigned char>(1 + random() % 255);
      EXPECT_FALSE(decode_rgbe_still(wrong, "wrong"));
      // Signed anew it is a picture, or refused.
      if (!is_rgbe_still(wrong)) continue;
      sign(wrong);
      const auto is = decode_rgbe_still(wrong, "signed");
      EXPECT_TRUE(!is || !is->pixels.empty());
    }
  }
}

TEST(RgbeStill, FewBytesClaimNoGigabytes) {
  auto file = encode_rgbe_still_as(textured_slope(), {RgbeBase::kContinuous, 100})->bytes;
  const std::uint32_t side = 9000;
  std::memcpy(file.data() + 16, &side, sizeof side);
  std::memcpy(file.data() + 20, &side, sizeof side);
  sign(file);
  const auto is = decode_rgbe_still(file, "huge");
  ASSERT_FALSE(is);
  EXPECT_EQ(is.error().detail, "claims more pixels than its bytes can hold");
  // What is as empty as can be is written all the same.
  const Image<Rgb> empty(3000, 2000, Rgb{1, 1, 1});
  EXPECT_EQ(back_from(empty, {RgbeBase::kContinuous, 500}).height(), 2000);
}

}  // namespace

}  // namespace penumbra::codec
