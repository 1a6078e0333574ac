#include "codec/log/log_jpeg2000.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "codec/codec.h"
#include "codec/internal/goal_search.h"
#include "core/conventions.h"
#include "core/io/hash.h"
#include "tests/fuzz/mutate.h"

namespace penumbra::codec {
namespace {

using Bytes = std::vector<unsigned char>;

// A coloured room over 20 stops with texture, a window and a sun.
Image<Rgb> room(int width, int height) {
  Image<Rgb> out(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const double u = double(x) / width, v = double(y) / height;
      double level = std::exp2(-6 + 8 * u) * (1 + .3 * std::sin(40 * u) * std::sin(31 * v));
      if (std::abs(u - .6) < .1 && std::abs(v - .3) < .1) level *= 60;
      if (std::hypot(u - .25, v - .2) < .02) level = 20000;
      const auto l = static_cast<float>(level);
      out.at(x, y) = {l, l * static_cast<float>(.5 + .3 * v), l * static_cast<float>(.3 + .5 * u)};
    }
  return out;
}

// Of luminance over all pixels, as a part of it.
struct LogErrors {
  double rms = 0, worst = 0;
};
LogErrors errors_of(const Image<Rgb>& truth, const Image<Rgb>& decoded) {
  LogErrors out;
  for (std::size_t i = 0; i < truth.area(); ++i) {
    const double error = std::log10(luminance(decoded.pixels()[i]) / luminance(truth.pixels()[i]));
    out.rms += error * error / static_cast<double>(truth.area());
    out.worst = std::max(out.worst, std::abs(error));
  }
  out.rms = std::sqrt(out.rms);
  return out;
}

double worst_chromaticity(const Image<Rgb>& truth, const Image<Rgb>& decoded) {
  double worst = 0;
  for (std::size_t i = 0; i < truth.area(); ++i) {
    const Rgb &a = truth.pixels()[i], &b = decoded.pixels()[i];
    const double sa = a.r + a.g + a.b, sb = b.r + b.g + b.b;
    worst = std::max({worst, std::abs(a.r / sa - b.r / sb), std::abs(a.b / sa - b.b / sb)});
  }
  return worst;
}

class LogJpeg2000 : public testing::TestWithParam<WaveletCoder> {};
INSTANTIATE_TEST_SUITE_P(Coders, LogJpeg2000,
                         testing::Values(WaveletCoder::kFast, WaveletCoder::kSmall));

TEST_P(LogJpeg2000, KeepsToTheErrorThatIsWished) {
  const Image<Rgb> truth = room(200, 120);
  std::size_t before = std::numeric_limits<std::size_t>::max();
  for (const double deviation : {.002, .01, .05}) {
    const auto coded = encode_log_jpeg2000(truth, {.deviation = deviation}, GetParam());
    ASSERT_TRUE(coded) << coded.error().detail;
    const auto back = decode_log_jpeg2000(coded->bytes, "picture");
    ASSERT_TRUE(back) << back.error().detail;
    const double rms = errors_of(truth, back->pixels).rms;
    EXPECT_LE(rms, deviation * 1.0001);
    EXPECT_NEAR(coded->error.luminance_rms, rms, 1e-5);
    EXPECT_NEAR(coded->error.luminance_max, errors_of(truth, back->pixels).worst, 1e-5);
    EXPECT_LE(coded->error.larger(), deviation);
    EXPECT_GE(coded->error.larger(), deviation * .8) << "smaller would have done";
    EXPECT_LT(coded->bytes.size(), before);
    before = coded->bytes.size();
  }
}

TEST_P(LogJpeg2000, FitsIntoTheBytesThatItIsGiven) {
  const Image<Rgb> truth = room(200, 120);
  for (const std::size_t bytes : {1500, 4000, 8000}) {
    const auto coded = encode_log_jpeg2000(truth, {.max_bytes = bytes}, GetParam());
    ASSERT_TRUE(coded) << coded.error().detail;
    EXPECT_LE(coded->bytes.size(), bytes);
    EXPECT_GT(coded->bytes.size(), bytes * 8 / 10);
  }
  const auto none = encode_log_jpeg2000(truth, {.max_bytes = 100}, GetParam());
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kUndetermined);
}

TEST_P(LogJpeg2000, ExactlyBoundsEachPixelAndTakesFewerBitsForMore) {
  const Image<Rgb> truth = room(160, 100);
  std::size_t before = std::numeric_limits<std::size_t>::max();
  for (const double deviation : {.0002, .002, .02}) {
    const auto coded = encode_log_jpeg2000_exactly(truth, {.deviation = deviation}, GetParam());
    ASSERT_TRUE(coded) << coded.error().detail;
    const auto back = decode_log_jpeg2000(coded->bytes, "picture");
    ASSERT_TRUE(back) << back.error().detail;
    EXPECT_LE(errors_of(truth, back->pixels).worst, deviation);
    EXPECT_LT(worst_chromaticity(truth, back->pixels), deviation * 3);
    EXPECT_LT(coded->bytes.size(), before * 9 / 10);
    before = coded->bytes.size();
  }
  // 20 stops in 16 bits: no finer than that.
  const auto finer = encode_log_jpeg2000_exactly(truth, {.deviation = 2e-5}, GetParam());
  ASSERT_FALSE(finer);
  EXPECT_EQ(finer.error().code, ErrorCode::kUndetermined);
}

// Scales far from 1 round otherwise.
TEST_P(LogJpeg2000, ExactlyIsSoAtAnyScale) {
  for (const float scale : {0x1p-60f, 0x1p20f, 0x1p60f}) {
    Image<Rgb> truth = room(80, 70);
    for (Rgb& p : truth.pixels()) p = scale * p;
    const auto coded = encode_log_jpeg2000_exactly(truth, {.deviation = .0001}, GetParam());
    ASSERT_TRUE(coded) << coded.error().detail;
    EXPECT_LE(errors_of(truth, decode_log_jpeg2000(coded->bytes, "p")->pixels).worst, .0001);
  }
}

// Errors have floors, at which a step by the excess alone stands still.
TEST(GoalSearch, FindsWhatCanBeReachedAndSaysWhatCannot) {
  for (const double floor : {0., .5, .95, .999}) {
    int tries = 0;
    const auto coder = [&](double coarseness) -> Result<CodedStill> {
      ++tries;
      CodedStill out;
      out.bytes.resize(static_cast<std::size_t>(100 + 1 / coarseness));
      out.error.luminance_rms = .01 * std::hypot(floor, 40 * coarseness);
      return out;
    };
    const auto found = search_goal({.deviation = .01}, 2e-5, .5, .006, coder);
    ASSERT_TRUE(found) << floor << ' ' << found.error().detail;
    EXPECT_LE(found->error.luminance_rms, .01);
    EXPECT_LE(tries, 12);
    EXPECT_TRUE(search_goal({.max_bytes = 5000}, 2e-5, .5, .006, coder));
    const auto none = search_goal({.deviation = .0099 * floor}, 2e-5, .5, .006, coder);
    if (floor == 0) continue;
    ASSERT_FALSE(none);
    const std::string best = none.error().detail.substr(none.error().detail.find("off by ") + 7);
    EXPECT_NEAR(std::stod(best), 100 * (std::pow(10, .01 * floor) - 1), .01) << best;
  }
}

TEST(LogJpeg2000Planes, SaturatedColoursAndOnesBeyondRec709AreKeptAsFarAsItGoes) {
  for (const Rgb colour :
       {Rgb{1, 1e-4f, 1e-4f}, Rgb{1e-5f, 1e-4f, 1}, Rgb{0, .1f, -.3f}, Rgb{1, -.2f, .1f}}) {
    Image<Rgb> truth = room(80, 70);
    for (int y = 20; y < 50; ++y)
      for (int x = 20; x < 50; ++x) truth.at(x, y) = colour;
    const auto coded = encode_log_jpeg2000(truth);
    ASSERT_TRUE(coded) << coded.error().detail;
    const Rgb back = decode_log_jpeg2000(coded->bytes, "p")->pixels.at(35, 35);
    EXPECT_NEAR(luminance(back) / luminance(colour), 1, .1);
    EXPECT_GE(std::min({back.r, back.g, back.b}), 0);
  }
}

// Its luminance is below 0, and it is no black.
TEST(LogJpeg2000Planes, AColourFarBeyondRec709KeepsWhatIsAboveZero) {
  Image<Rgb> truth = room(80, 70);
  for (int y = 20; y < 50; ++y)
    for (int x = 20; x < 50; ++x) truth.at(x, y) = {2, -1, .5f};
  const auto coded = encode_log_jpeg2000_exactly(truth, {.deviation = .005});
  ASSERT_TRUE(coded) << coded.error().detail;
  EXPECT_EQ(coded->error.negative, 900U);
  const Rgb back = decode_log_jpeg2000(coded->bytes, "p")->pixels.at(35, 35);
  EXPECT_NEAR(back.r, 2, .05);
  EXPECT_NEAR(back.g, 0, .05);
  EXPECT_NEAR(back.b, .5, .05);
}

double sphere_sum(const Image<Rgb>& map, int channel) {
  double sum = 0;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      sum += std::sin(kPi * (y + .5) / map.height()) * double{map.at(x, y)[channel]};
  return sum;
}

// Rows at the zenith are many pixels of little light.
TEST(LogJpeg2000Planes, LightOfALatLongMapIsThatOfTheSphere) {
  Image<Rgb> truth(256, 128);
  for (int y = 0; y < 128; ++y)
    for (int x = 0; x < 256; ++x)
      truth.at(x, y) = y < 3 ? Rgb{2e4f, 3e4f, 5e4f} : Rgb{.3f, .25f, .2f};
  for (int y = 60; y < 63; ++y)
    for (int x = 100; x < 104; ++x) truth.at(x, y) = {9e3f, 6e3f, 3e3f};
  const auto coded = encode_log_jpeg2000(truth);
  ASSERT_TRUE(coded) << coded.error().detail;
  const Image<Rgb> back = decode_log_jpeg2000(coded->bytes, "p")->pixels;
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(sphere_sum(back, c) / sphere_sum(truth, c), 1, .025) << c;
}

// Colour of few pixels that are most of a channel's light.
TEST(LogJpeg2000Planes, EveryPixelIsAlsoTheLightOfEachChannel) {
  Image<Rgb> truth(128, 64);
  for (Rgb& p : truth.pixels()) p = {.1f, .2f, .3f};
  truth.at(60, 30) = {1e6f, 1e5f, 1e4f};
  const auto coded = encode_log_jpeg2000_exactly(truth, {.deviation = .00432});
  ASSERT_TRUE(coded) << coded.error().detail;
  EXPECT_LE(coded->error.light, .00432);
}

TEST(LogJpeg2000Planes, WhatTheEnvironmentIsIsKept) {
  const auto with = [](std::optional<EnvironmentAttribute> environment) {
    const auto coded = encode_log_jpeg2000(room(80, 70), {}, WaveletCoder::kFast, environment);
    return decode_log_jpeg2000(coded->bytes, "p")->environment;
  };
  for (const auto environment : {EnvironmentAttribute::kLatLong, EnvironmentAttribute::kCube})
    EXPECT_EQ(with(environment), environment);
  EXPECT_EQ(with({}), std::nullopt);
}

TEST(LogJpeg2000Planes, BlackStaysBlackAndItsNeighboursKeepTheirColour) {
  Image<Rgb> truth = room(96, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 20; ++x) truth.at(x, y) = {};
  truth.at(50, 50) = {1e-20f, 1e-20f, 1e-20f};  // darker than the scale reaches
  const auto coded = encode_log_jpeg2000_exactly(truth, {.deviation = .001});
  ASSERT_TRUE(coded) << coded.error().detail;
  const auto back = decode_log_jpeg2000(coded->bytes, "picture");
  ASSERT_TRUE(back);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 20; ++x) EXPECT_EQ(back->pixels.at(x, y), Rgb());
  EXPECT_EQ(back->pixels.at(50, 50), Rgb());
  EXPECT_NEAR(back->pixels.at(30, 30).r / truth.at(30, 30).r, 1, .01);
}

TEST(LogJpeg2000Planes, AllBlackAndSinglePixelsAndThinPicturesComeBack) {
  for (const WaveletCoder coder : {WaveletCoder::kFast, WaveletCoder::kSmall}) {
    for (const auto& [width, height] : {std::pair{1, 1}, {1, 40}, {40, 1}, {3, 5}, {33, 2}}) {
      Image<Rgb> truth(width, height);
      const auto black = encode_log_jpeg2000(truth, {}, coder);
      ASSERT_TRUE(black) << width << 'x' << height << ' ' << black.error().detail;
      const auto nothing = decode_log_jpeg2000(black->bytes, "picture");
      ASSERT_TRUE(nothing) << nothing.error().detail;
      for (const Rgb& p : nothing->pixels.pixels()) EXPECT_EQ(p, Rgb());
      for (Rgb& p : truth.pixels()) p = {3, 2, 1};
      const auto coded = encode_log_jpeg2000(truth, {}, coder);
      ASSERT_TRUE(coded) << coded.error().detail;
      const auto back = decode_log_jpeg2000(coded->bytes, "picture");
      ASSERT_TRUE(back) << back.error().detail;
      EXPECT_TRUE(back->pixels.same_size(truth));
      EXPECT_NEAR(back->pixels.at(width / 2, height / 2).g, 2, .05);
    }
  }
}

TEST(LogJpeg2000Planes, ASunAndADarkCornerAreAsExactAsTheMiddle) {
  Image<Rgb> truth = room(128, 128);
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 32; ++x) truth.at(x, y) = {1e-3f, 2e-3f, 1e-3f};
  for (int y = 96; y < 128; ++y)
    for (int x = 96; x < 128; ++x) truth.at(x, y) = {3e5f, 2e5f, 1e5f};
  const auto coded = encode_log_jpeg2000(truth, {.deviation = .01});
  ASSERT_TRUE(coded);
  const auto back = decode_log_jpeg2000(coded->bytes, "picture");
  ASSERT_TRUE(back);
  const auto mean_over = [](const Image<Rgb>& image, int x0) {
    double sum = 0;
    for (int y = x0 + 8; y < x0 + 24; ++y)
      for (int x = x0 + 8; x < x0 + 24; ++x) sum += luminance(image.at(x, y)) / 256.;
    return sum;
  };
  EXPECT_NEAR(mean_over(back->pixels, 0) / mean_over(truth, 0), 1, .02);
  EXPECT_NEAR(mean_over(back->pixels, 96) / mean_over(truth, 96), 1, .02);
}

// By the mean over pixels alone a sun of a few may lose a tenth of its light and more.
TEST(LogJpeg2000Planes, AFewPixelsThatHoldMostOfTheLightKeepIt) {
  Image<Rgb> truth(256, 128);
  for (int y = 0; y < 128; ++y)
    for (int x = 0; x < 256; ++x) {
      const float level = .2f + .002f * static_cast<float>(y);
      truth.at(x, y) = {.6f * level, .8f * level, level};
    }
  for (int y = 40; y < 43; ++y)
    for (int x = 100; x < 103; ++x) truth.at(x, y) = {9e4f, 7e4f, 5e4f};
  for (const WaveletCoder coder : {WaveletCoder::kFast, WaveletCoder::kSmall}) {
    const auto coded = encode_log_jpeg2000(truth, {.deviation = .0086}, coder);
    ASSERT_TRUE(coded) << coded.error().detail;
    const auto back = decode_log_jpeg2000(coded->bytes, "sun.jph");
    ASSERT_TRUE(back);
    for (int c = 0; c < 3; ++c) {
      double light = 0, kept = 0;
      for (std::size_t i = 0; i < truth.area(); ++i) {
        light += double{truth.pixels()[i][c]};
        kept += double{back->pixels.pixels()[i][c]};
      }
      EXPECT_NEAR(kept / light, 1, .021) << c;
    }
  }
}

TEST(LogJpeg2000Input, WhatCannotBeCodedIsRefusedByName) {
  Image<Rgb> picture = room(40, 30);
  const auto empty = encode_log_jpeg2000({});
  ASSERT_FALSE(empty);
  EXPECT_EQ(empty.error().code, ErrorCode::kInvalid);
  picture.at(7, 3).g = std::numeric_limits<float>::quiet_NaN();
  const auto nan = encode_log_jpeg2000(picture);
  ASSERT_FALSE(nan);
  EXPECT_EQ(nan.error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(nan.error().where, "pixel 7, 3");
  picture.at(7, 3).g = std::numeric_limits<float>::infinity();
  EXPECT_EQ(encode_log_jpeg2000(picture).error().code, ErrorCode::kNonFinite);
  picture.at(7, 3) = {-1, .1f, -1};  // no luminance: black, not an error
  EXPECT_TRUE(encode_log_jpeg2000(picture));
  for (const double deviation : {0., -1., 2., std::numeric_limits<double>::quiet_NaN()})
    EXPECT_EQ(encode_log_jpeg2000(picture, {.deviation = deviation}).error().code,
              ErrorCode::kInvalid);
  EXPECT_EQ(encode_log_jpeg2000_exactly(picture, {.max_bytes = 1000}).error().code,
            ErrorCode::kInvalid);
}

TEST(LogJpeg2000Input, EveryCutIsRefused) {
  const auto coded = encode_log_jpeg2000(room(80, 70));
  ASSERT_TRUE(coded);
  for (std::size_t n = 0; n < coded->bytes.size(); n += 1 + coded->bytes.size() / 97) {
    const auto cut = decode_log_jpeg2000(std::span(coded->bytes).first(n), "cut.jph");
    ASSERT_FALSE(cut) << n;
    EXPECT_EQ(cut.error().code, ErrorCode::kUnreadable);
    EXPECT_EQ(cut.error().where, "cut.jph");
  }
}

std::size_t place_of(const Bytes& bytes, const Bytes& what) {
  const auto found = std::search(bytes.begin(), bytes.end(), what.begin(), what.end());
  return static_cast<std::size_t>(found - bytes.begin());
}

// A file's fingerprint of its codestream, made again where a test changes that.
void put_fingerprint(Bytes& bytes) {
  const std::size_t scale = place_of(bytes, {'u', 'u', 'i', 'd'}) + 4,
                    codestream = place_of(bytes, {'j', 'p', '2', 'c'}) + 4;
  std::uint64_t value =
      Fnv1a().add(&bytes[scale], 28).add(&bytes[codestream], bytes.size() - codestream).value();
  for (std::size_t i = 8; i-- > 0; value >>= 8)
    bytes[scale + 28 + i] = static_cast<unsigned char>(value);
}

TEST(LogJpeg2000Input, AFewBytesThatClaimAHundredMegapixelsAreRefusedBeforeAnythingIsAllocated) {
  Bytes bytes = encode_log_jpeg2000(room(80, 70))->bytes;
  // SIZ: marker, length, capabilities, width, height.
  const std::size_t size = place_of(bytes, {0xff, 0x51}) + 6;
  const Bytes ten_thousand{0, 0, 0x27, 0x10, 0, 0, 0x27, 0x10};
  std::ranges::copy(ten_thousand, bytes.begin() + static_cast<std::ptrdiff_t>(size));
  std::ranges::copy(ten_thousand, bytes.begin() + static_cast<std::ptrdiff_t>(size) + 16);  // tile
  EXPECT_NE(decode_log_jpeg2000(bytes, "huge.jph").error().detail.find("fingerprint"),
            std::string::npos);
  put_fingerprint(bytes);
  const auto result = decode_log_jpeg2000(bytes, "huge.jph");
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalid);
  EXPECT_NE(result.error().detail.find("10000 x 10000"), std::string::npos)
      << result.error().detail;
}

// OpenJPEG makes room for every tile and plane before it says how many there are.
TEST(LogJpeg2000Input, ManyTilesOrPlanesAreNotOurs) {
  const Bytes whole = encode_log_jpeg2000(room(80, 70))->bytes;
  const std::size_t size = place_of(whole, {0xff, 0x51});
  for (const auto& [at, value] : {std::pair{22, 1}, {26, 1}, {39, 200}, {14, 1}, {40, 7}}) {
    Bytes bytes = whole;
    bytes[size + static_cast<std::size_t>(at) + (at == 39 ? 0 : 3) - (at == 40 ? 3 : 0)] =
        static_cast<unsigned char>(value);
    put_fingerprint(bytes);
    const auto result = decode_log_jpeg2000(bytes, "tiles.jph");
    ASSERT_FALSE(result) << at;
    EXPECT_NE(result.error().detail.find("three planes"), std::string::npos)
        << at << ' ' << result.error().detail;
  }
}

TEST(LogJpeg2000Input, AnEvenPictureOfManyPixelsIsReadThoughItTakesFewBytes) {
  Image<Rgb> truth(2048, 1024);
  for (Rgb& p : truth.pixels()) p = {.5f, .5f, .5f};
  const auto coded = encode_log_jpeg2000(truth);
  ASSERT_TRUE(coded);
  EXPECT_LT(coded->bytes.size(), 4000u);
  const auto back = decode_log_jpeg2000(coded->bytes, "even.jph");
  ASSERT_TRUE(back) << back.error().detail;
  EXPECT_NEAR(back->pixels.at(1000, 1000).r, .5, .01);
}

TEST(LogJpeg2000Input, APictureByOthersSaysThatItHasNoScaleOfLight) {
  Bytes bytes = encode_log_jpeg2000(room(80, 70))->bytes;
  bytes[place_of(bytes, {'u', 'u', 'i', 'd'})] = 'v';  // a box that nobody knows
  const auto result = decode_log_jpeg2000(bytes, "other.jp2");
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().detail.find("how bright"), std::string::npos);
}

// Without the fingerprint OpenJPEG's decoder of fast blocks stops the program at some.
TEST(LogJpeg2000Input, DamagedBytesEndInAnErrorOrAPicture) {
  for (const WaveletCoder coder : {WaveletCoder::kFast, WaveletCoder::kSmall}) {
    const Bytes whole = encode_log_jpeg2000(room(80, 70), {}, coder)->bytes;
    int refused = 0;
    test::mutate_and_run(whole, 400, 5, [&](std::span<const unsigned char> bytes) {
      const auto result = decode_log_jpeg2000(bytes, "damaged.jph");
      if (result) {
        EXPECT_FALSE(result->pixels.empty());
      } else {
        ++refused;
        EXPECT_FALSE(result.error().detail.empty());
      }
    });
    EXPECT_GT(refused, 100);
  }
}

}  // namespace
}  // namespace penumbra::codec
