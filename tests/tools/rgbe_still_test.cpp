#include "tools/chart/peers/rgbe_still.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace penumbra::tools {

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

double relative_rms(const Image<Rgb>& truth, const Image<Rgb>& is) {
  double sum = 0;
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const Rgb& t = truth.pixels()[i];
      if (t.r > 0) sum += std::pow((is.pixels()[i][c] - t[c]) / t.r, 2);
    }
  return std::sqrt(sum / (3. * static_cast<double>(truth.area())));
}

TEST(RgbeStill, WithoutLossEveryCodeComesBack) {
  const Image<Rgb> truth = textured_slope();
  const auto bytes = encode_rgbe_still(truth, RgbeBase::kLossless, 0);
  ASSERT_TRUE(bytes) << bytes.error().detail;
  const auto is = decode_rgbe_still(*bytes, "test");
  ASSERT_TRUE(is) << is.error().detail;
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c)  // half a step of eight bits, of which the largest uses half
      ASSERT_LE(std::abs(is->pixels()[i][c] - truth.pixels()[i][c]), truth.pixels()[i].r / 256)
          << i;
  EXPECT_EQ(is->at(2, 2), Rgb{});
  // What stands for a code is that code again.
  const auto again = decode_rgbe_still(*encode_rgbe_still(*is, RgbeBase::kLossless, 0), "test");
  ASSERT_TRUE(again);
  EXPECT_EQ(*again, *is);
  EXPECT_LT(bytes->size(), 3 * truth.area());
}

TEST(RgbeStill, BetterQualityIsLargerAndNearer) {
  const Image<Rgb> truth = textured_slope();
  double before = 1;
  std::size_t size = 0;
  for (const int quality : {10, 50, 80, 95}) {
    const auto bytes = encode_rgbe_still(truth, RgbeBase::kAdaptiveJpeg, quality);
    ASSERT_TRUE(bytes);
    const auto is = decode_rgbe_still(*bytes, "test");
    ASSERT_TRUE(is);
    const double error = relative_rms(truth, *is);
    EXPECT_LT(error, before) << quality;
    EXPECT_GT(bytes->size(), size);
    before = error, size = bytes->size();
  }
  EXPECT_LT(before, .035);  // colours at half resolution
}

// Figure 4.6 (e) and (f): a base that falls from 255 to 128 where the light goes on is an edge to
// the cosines, and their error there is one of the larger value.
TEST(RgbeStill, OneTableOfStepsRingsWhereExponentsStep) {
  const Image<Rgb> truth = textured_slope();
  const auto error_of = [&](RgbeBase base) {
    return relative_rms(truth, *decode_rgbe_still(*encode_rgbe_still(truth, base, 50), "test"));
  };
  const double one_table = error_of(RgbeBase::kJpeg);
  const double adaptive = error_of(RgbeBase::kAdaptiveJpeg);
  EXPECT_LT(adaptive, .85 * one_table);
}

TEST(RgbeStill, BadInputIsRefusedAndDamageEndsNothing) {
  EXPECT_FALSE(encode_rgbe_still({}, RgbeBase::kJpeg, 50));
  Image<Rgb> picture = textured_slope();
  EXPECT_FALSE(encode_rgbe_still(picture, RgbeBase::kJpeg, 0));
  const auto bytes = *encode_rgbe_still(picture, RgbeBase::kAdaptiveJpeg, 60);
  picture.at(3, 3).g = NAN;
  EXPECT_FALSE(encode_rgbe_still(picture, RgbeBase::kJpeg, 50));
  EXPECT_FALSE(decode_rgbe_still(std::span(bytes).first(13), "cut"));
  for (std::size_t cut = 14; cut < bytes.size(); cut += 17) {
    const auto is = decode_rgbe_still(std::span(bytes).first(cut), "cut");
    EXPECT_TRUE(is && is->same_size(picture));
  }
  std::mt19937 random(5);
  for (int i = 0; i < 60; ++i) {
    auto wrong = bytes;  // behind its sizes: those of gigabytes are for the reader's limits
    wrong[14 + random() % (wrong.size() - 14)] ^= static_cast<unsigned char>(1 + random() % 255);
    EXPECT_TRUE(decode_rgbe_still(wrong, "wrong"));
  }
  auto huge = bytes;
  huge[9] = huge[11] = 0xff;
  EXPECT_FALSE(decode_rgbe_still(huge, "huge"));
}

}  // namespace

}  // namespace penumbra::tools
