#include "codec/tone/tone_mapping.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "codec/codec.h"
#include "codec/display.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "tests/support/temp_folder.h"

namespace penumbra::tone {
namespace {

constexpr std::array kAll{ToneOperator::kLevelSet, ToneOperator::kPhotographic,
                          ToneOperator::kPhotographicLocal, ToneOperator::kBilateral,
                          ToneOperator::kFilmic};
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Coloured waves under light of five decades.
Image<Rgb> scene(float factor = 1) {
  Image<Rgb> out(120, 80);
  for (int y = 0; y < 80; ++y)
    for (int x = 0; x < 120; ++x) {
      const auto fx = static_cast<float>(x), fy = static_cast<float>(y);
      const float light = factor * std::exp(2.3f * static_cast<float>((x / 24 + 2 * (y / 20)) % 5));
      out.at(x, y) = light * Rgb{1 + .5f * std::sin(.4f * fx), 1 + .5f * std::sin(.3f * fy),
                                 1 + .3f * std::cos(.2f * (fx + fy))};
    }
  return out;
}

int largest_code_difference(const Image<Rgb8>& a, const Image<Rgb8>& b) {
  int out = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    const Rgb8 p = a.pixels()[i], q = b.pixels()[i];
    out = std::max({out, std::abs(p.r - q.r), std::abs(p.g - q.g), std::abs(p.b - q.b)});
  }
  return out;
}

double shown_luminance(Rgb8 p) {
  const auto linear = [](std::uint8_t v) {
    return codec::linear_from_srgb(static_cast<float>(v) / 255);
  };
  return luminance({linear(p.r), linear(p.g), linear(p.b)});
}

double mean_luminance(const Image<Rgb8>& picture) {
  double sum = 0;
  for (const Rgb8 p : picture.pixels()) sum += shown_luminance(p);
  return sum / static_cast<double>(picture.area());
}

TEST(Srgb, CodesAreThoseOfTheStandard) {
  for (int code = 0; code < 256; ++code)
    EXPECT_EQ(codec::srgb_code(codec::linear_from_srgb(static_cast<float>(code) / 255)), code);
  for (int i = -2000; i <= 12000; ++i) {
    const double v = i * 1e-4 + 3e-5;
    const double curve =
        v <= .0031308 ? 12.92 * v : 1.055 * std::pow(std::max(v, 0.), 1 / 2.4) - .055;
    const double expected = std::clamp(curve * 255, 0., 255.);
    EXPECT_NEAR(codec::srgb_code(static_cast<float>(v)), expected, .5 + 1e-3) << v;
  }
  EXPECT_EQ(codec::srgb_code(kNan), 0);
  EXPECT_EQ(codec::srgb_code(kInfinity), 255);
  EXPECT_EQ(codec::srgb_code(-kInfinity), 0);
}

TEST(ToneMapping, NothingButBaseAndDetailIsInAPicture) {
  const Image<Rgb> picture = scene();
  const auto mapped = tone_map(picture);
  ASSERT_TRUE(mapped);
  Image<float> log(picture.width(), picture.height());
  const double floor = mapped->statistics.low;
  for (std::size_t i = 0; i < log.area(); ++i)
    log.pixels()[i] = static_cast<float>(
        std::max(floor, std::log(static_cast<double>(luminance(picture.pixels()[i])))));
  const auto profile = level_set_profile(log, mapped->statistics.range());
  ASSERT_TRUE(profile);
  double largest = 0;
  for (std::size_t i = 0; i < log.area(); ++i) {
    ASSERT_NEAR(double{profile->pixels()[i]} + mapped->detail.pixels()[i], log.pixels()[i], 3e-6);
    const float detail = log.pixels()[i] - profile->pixels()[i];
    ASSERT_NEAR(double{profile->pixels()[i]} + detail, log.pixels()[i], 1e-6);
    largest = std::max<double>(largest, std::abs(detail));
  }
  EXPECT_GT(largest, .01);
}

TEST(ToneMapping, AConstantPictureHasNoDetailAndOneColour) {
  for (const ToneOperator op : kAll) {
    const auto mapped = tone_map(Image<Rgb>(33, 21, {.02f, .05f, .3f}), {.op = op});
    ASSERT_TRUE(mapped);
    for (const float v : mapped->detail.pixels()) ASSERT_NEAR(v, 0, 1e-6);
    for (const Rgb8 p : mapped->pixels.pixels()) ASSERT_EQ(p, mapped->pixels.at(0, 0));
    EXPECT_GT(mapped->pixels.at(0, 0).b, mapped->pixels.at(0, 0).r);
  }
}

// Even fields of rising light, wide enough that their middles know nothing of the others.
TEST(ToneMapping, IsMonotoneWhereNoDetailIs) {
  constexpr int kFields = 12, kSide = 160;
  Image<Rgb> picture(kFields * kSide, 8);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < picture.width(); ++x) {
      const float l = std::exp(.8f * static_cast<float>(x / kSide) - 6);
      picture.at(x, y) = {l, l, l};
    }
  for (const ToneOperator op : kAll) {
    const auto mapped = tone_map(picture, {.op = op, .bilateral_fraction = .005});
    ASSERT_TRUE(mapped);
    int last = -1;
    for (int k = 0; k < kFields; ++k) {
      const int x = k * kSide + kSide / 2;
      if (!mapped->detail.empty()) {
        ASSERT_NEAR(mapped->detail.at(x, 4), 0, 1e-5) << k;
      }
      const int code = mapped->pixels.at(x, 4).g;
      EXPECT_TRUE(code > last || code == 255) << static_cast<int>(op) << ' ' << k;
      last = code;
    }
    EXPECT_GT(last, 180) << static_cast<int>(op);
  }
}

TEST(ToneMapping, OneFactorOnTheLightChangesNothing) {
  for (const ToneOperator op : kAll) {
    const auto a = tone_map(scene(), {.op = op});
    for (const float factor : {1e-9f, 256.f, 3e11f}) {
      const auto b = tone_map(scene(factor), {.op = op});
      ASSERT_TRUE(a && b);
      EXPECT_LE(largest_code_difference(a->pixels, b->pixels), 2)
          << static_cast<int>(op) << ' ' << factor;
    }
  }
}

TEST(ToneMapping, MoreExposureIsBrighter) {
  for (const ToneOperator op : kAll) {
    double last = 0;
    for (const double stops : {-4., -1., 0., 1., 3.}) {
      const auto mapped = tone_map(scene(), {.op = op, .exposure_stops = stops});
      ASSERT_TRUE(mapped);
      const double now = mean_luminance(mapped->pixels);
      EXPECT_GT(now, last) << static_cast<int>(op) << ' ' << stops;
      last = now;
    }
  }
}

// A red of the display's own luminance of .2126 cannot be shown brighter than that: it pales and
// keeps its luminance.
TEST(ToneMapping, AColourTheDisplayLacksKeepsItsLuminance) {
  Image<Rgb> picture(64, 64, {1, 1, 1});
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 64; ++x) picture.at(x, y) = {1 / .2126f, 0, 0};
  const auto mapped = tone_map(
      picture, {.op = ToneOperator::kPhotographic, .key = .9, .saturation = 1, .white = 2});
  ASSERT_TRUE(mapped);
  const Rgb8 red = mapped->pixels.at(10, 10), grey = mapped->pixels.at(10, 50);
  EXPECT_EQ(red.r, 255);
  EXPECT_GT(red.g, 100);
  EXPECT_NEAR(shown_luminance(red), shown_luminance(grey), .01);
}

TEST(ToneMapping, GreyStaysGreyAtAnySaturation) {
  Image<Rgb> picture = scene();
  for (Rgb& p : picture.pixels()) p = {p.g, p.g, p.g};
  for (const double saturation : {0., .5, 2.}) {
    const auto mapped = tone_map(picture, {.saturation = saturation});
    ASSERT_TRUE(mapped);
    for (const Rgb8 p : mapped->pixels.pixels())
      ASSERT_LE(std::max({p.r, p.g, p.b}) - std::min({p.r, p.g, p.b}), 1);
  }
}

TEST(Photographic, IsTheCurveOfThePaper) {
  Image<float> luminance(64, 1);
  for (int x = 0; x < 64; ++x) luminance.at(x, 0) = std::exp2(static_cast<float>(x) / 4 - 8);
  const auto shown = photographic(luminance, 20, false);
  ASSERT_TRUE(shown);
  for (int x = 0; x < 64; ++x) {
    const double l = luminance.at(x, 0), expected = std::min(1., l * (1 + l / 400) / (1 + l));
    EXPECT_NEAR(shown->at(x, 0), expected, 1e-6);
  }
}

TEST(Photographic, WithoutContrastLocalIsGlobal) {
  const Image<float> even(60, 40, 1.7f);
  const auto global = photographic(even, 5, false), local = photographic(even, 5, true);
  ASSERT_TRUE(global && local);
  EXPECT_NEAR(global->at(30, 20), local->at(30, 20), 1e-5);
}

// Dodging and burning: a dark spot on a bright ground is compared with itself, so that it does not
// lie under the ground's compression; a faint one is, and gains contrast.
TEST(Photographic, LocalContrastExceedsGlobal) {
  Image<float> faint(160, 160, 3);
  for (int y = 78; y < 82; ++y)
    for (int x = 78; x < 82; ++x) faint.at(x, y) = 2.9f;
  const auto global = photographic(faint, 1e6, false), local = photographic(faint, 1e6, true);
  ASSERT_TRUE(global && local);
  const auto contrast = [](const Image<float>& shown) {
    return shown.at(20, 20) / shown.at(80, 80);
  };
  EXPECT_GT(contrast(*local), contrast(*global) + .01);
}

// Hable's constants by hand: at 1, .204 / .71 - 1/15, at 11.2, 19.38 / 24.476 - 1/15.
TEST(Film, IsHablesCurve) {
  EXPECT_EQ(filmic_curve(0), 0);
  EXPECT_NEAR(filmic_curve(11.2f), 1, 1e-6);
  const double at_one = .204 / .71 - 1 / 15., at_white = 19.38 / 24.476 - 1 / 15.;
  EXPECT_NEAR(filmic_curve(1), at_one / at_white, 1e-6);
  EXPECT_EQ(filmic_curve(std::numeric_limits<float>::max()), 1);
  float last = -1;
  for (float x = 0; x < 11; x += .1f) {
    EXPECT_GT(filmic_curve(x), last);
    last = filmic_curve(x);
  }
}

TEST(ToneStatistics, AreThoseOfTheLight) {
  Image<Rgb> picture(1000, 10);
  for (std::size_t i = 0; i < picture.area(); ++i) {
    const float l = std::exp2(static_cast<float>(i % 1000) / 100);
    picture.pixels()[i] = {l, l, l};
  }
  const auto s = measure_tone(picture);
  ASSERT_TRUE(s);
  EXPECT_NEAR(s->mean / std::numbers::ln2, 4.995, 1e-3);
  EXPECT_NEAR(s->median / std::numbers::ln2, 5, .01);
  EXPECT_NEAR(s->low / std::numbers::ln2, 0, .02);
  EXPECT_NEAR(s->high / std::numbers::ln2, 9.98, .02);
  EXPECT_FALSE(s->black);
}

TEST(ToneMapping, WhatIsNotFiniteIsRefusedByItsPlace) {
  for (const float bad : {kNan, kInfinity, -kInfinity}) {
    Image<Rgb> picture = scene();
    picture.at(17, 60).g = bad;
    const auto refused = tone_map(picture);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kNonFinite);
    EXPECT_NE(refused.error().detail.find("(17, 60)"), std::string::npos);
  }
}

TEST(ToneMapping, NegativeComponentsCountAsNone) {
  Image<Rgb> picture = scene(), cut = picture;
  picture.at(5, 5) = {2, -1, 3};
  picture.at(6, 5) = {-2, -1, -3};
  cut.at(5, 5) = {2, 0, 3};
  cut.at(6, 5) = {};
  const auto a = tone_map(picture), b = tone_map(cut);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->statistics.negative, 2U);
  EXPECT_EQ(a->pixels, b->pixels);
  EXPECT_EQ(a->pixels.at(6, 5), Rgb8{});
}

TEST(ToneMapping, BlackStaysBlack) {
  for (const ToneOperator op : kAll) {
    const auto mapped = tone_map(Image<Rgb>(20, 10), {.op = op});
    ASSERT_TRUE(mapped);
    EXPECT_TRUE(mapped->statistics.black);
    for (const Rgb8 p : mapped->pixels.pixels()) ASSERT_EQ(p, Rgb8{});
  }
}

// One pixel, one row, one column; the smallest and the largest light there is.
TEST(ToneMapping, OddPicturesAreShown) {
  const std::array sizes{std::array{1, 1}, std::array{200, 1}, std::array{1, 200},
                         std::array{2, 3}};
  const float most = std::numeric_limits<float>::max(), least = std::numeric_limits<float>::min();
  for (const ToneOperator op : kAll)
    for (const auto [width, height] : sizes) {
      Image<Rgb> picture(width, height, {.3f, .2f, .1f});
      picture.at(0, 0) = {most, most, most};
      picture.at(width - 1, height - 1) = {least, least / 4, 0};
      const auto mapped = tone_map(picture, {.op = op});
      ASSERT_TRUE(mapped) << static_cast<int>(op);
      EXPECT_EQ(mapped->pixels.width(), width);
      for (const float v : mapped->detail.pixels()) ASSERT_TRUE(std::isfinite(v));
    }
}

TEST(ToneMapping, BadOptionsAreRefusedByName) {
  const Image<Rgb> picture = scene();
  const std::array<std::pair<ToneOptions, const char*>, 7> bad{{
      {{.exposure_stops = 100}, "exposure"},
      {{.key = 0.}, "key"},
      {{.saturation = kNan}, "saturation"},
      {{.level_set = {.steps = 5000}}, "steps"},
      {{.contrast = 0}, "contrast"},
      {{.white = .5}, "white"},
      {{.bilateral_fraction = 0}, "fraction"},
  }};
  for (const auto& [options, name] : bad) {
    const auto refused = tone_map(picture, options);
    ASSERT_FALSE(refused) << name;
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
    EXPECT_NE(refused.error().where.find(name), std::string::npos) << refused.error().where;
  }
  EXPECT_FALSE(tone_map(Image<Rgb>()));
  EXPECT_FALSE(parse_tone_operator("levelset"));
  EXPECT_EQ(parse_tone_operator("photographic-local").value(), ToneOperator::kPhotographicLocal);
}

// A header that promises 100 megapixels over a few bytes costs no more memory than the bytes.
TEST(ToneMapping, AHeaderOfAHundredMegapixelsIsRefusedAtOnce) {
  const test::TempFolder folder;
  const auto file = folder.path() / "huge.hdr";
  ASSERT_TRUE(write_bytes(
      file, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 10000 +X 10000\n\x02\x02\x27\x10"));
  const auto read = codec::read_hdr(file);
  ASSERT_FALSE(read);
  EXPECT_EQ(read.error().code, ErrorCode::kUnreadable);
}

}  // namespace
}  // namespace penumbra::tone
