#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "codec/codec.h"
#include "core/conventions.h"
#include "core/io/files.h"
#include "tests/fuzz/mutate.h"
#include "tests/support/shared_data.h"
#include "tests/support/temp_folder.h"

namespace penumbra::codec {
namespace {

using test::TempFolder;

constexpr float kRadianceNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kRadianceInfinity = std::numeric_limits<float>::infinity();

std::span<const unsigned char> as_bytes(const std::string& text) {
  return {reinterpret_cast<const unsigned char*>(text.data()), text.size()};
}

Result<HdrImage> decode(const std::string& text) {
  return decode_radiance(as_bytes(text), "test.hdr");
}

const std::string kHeader = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n";

// At exponent 136 a pixel's red is its code.
std::string flat(std::initializer_list<int> reds) {
  std::string out;
  for (const int red : reds) out += {static_cast<char>(red), 0, 0, static_cast<char>(136)};
  return out;
}

std::vector<float> reds(const HdrImage& image) {
  std::vector<float> out;
  for (const Rgb& p : image.pixels.pixels()) out.push_back(p.r);
  return out;
}

Image<Rgb> noise(int width, int height, unsigned seed) {
  std::mt19937 rng(seed);
  Image<Rgb> image(width, height);
  for (Rgb& p : image.pixels())
    for (int c = 0; c < 3; ++c)
      p[c] =
          std::ldexp(static_cast<float>(rng() % 1000) / 1000.f, static_cast<int>(rng() % 40) - 20);
  return image;
}

std::string written(const Image<Rgb>& image) {
  const TempFolder folder;
  EXPECT_TRUE(write_hdr(folder.path() / "a.hdr", image));
  const auto bytes = read_bytes(folder.path() / "a.hdr");
  return bytes ? std::string(bytes->begin(), bytes->end()) : std::string();
}

TEST(Radiance, RoundTripStaysWithinHalfAStepOfTheBrightestChannel) {
  for (const int width : {1, 2, 7, 8, 9, 127, 128, 129, 300}) {
    const Image<Rgb> image = noise(width, 5, static_cast<unsigned>(width));
    const auto back = decode(written(image));
    ASSERT_TRUE(back) << back.error().detail;
    ASSERT_TRUE(back->pixels.same_size(image));
    for (std::size_t i = 0; i < image.area(); ++i) {
      const Rgb a = image.pixels()[i], b = back->pixels.pixels()[i];
      const float largest = std::max({a.r, a.g, a.b});
      for (int c = 0; c < 3; ++c)
        EXPECT_LE(std::abs(a[c] - b[c]), largest / 256) << width << " " << i;
    }
  }
}

TEST(Radiance, WritingWhatWasReadChangesNoByte) {
  const std::string once = written(noise(40, 7, 3));
  const auto back = decode(once);
  ASSERT_TRUE(back);
  EXPECT_EQ(written(back->pixels), once);
}

TEST(Radiance, RunsOfEveryLengthSurvive) {
  Image<Rgb> image(400, 390);
  for (int y = 0; y < image.height(); ++y)
    for (int x = 0; x < image.width(); ++x)
      image.at(x, y) = x < y ? Rgb{1, .5f, .25f} : Rgb{.5f, static_cast<float>(x % 2), 1};
  const auto back = decode(written(image));
  ASSERT_TRUE(back) << back.error().detail;
  EXPECT_EQ(back->pixels, image);
}

TEST(Radiance, WidestPicturesSurvive) {
  for (const int width : {32767, 32768}) {
    const Image<Rgb> image(width, 2, {.5f, 2, 1});
    const auto back = decode(written(image));
    ASSERT_TRUE(back) << back.error().detail;
    EXPECT_EQ(back->pixels, image);
  }
}

TEST(Radiance, WhatTheFormatCannotHoldBecomesTheNearestThatItCan) {
  const float largest = 255 * 0x1p119f;
  Image<Rgb> image(6, 1);
  image.at(0, 0) = {-1, 2, -3};
  image.at(1, 0) = {kRadianceNan, 1, kRadianceNan};
  image.at(2, 0) = {kRadianceInfinity, 0, 0};
  image.at(3, 0) = {1e-42f, 0, 0};
  image.at(4, 0) = {std::numeric_limits<float>::max(), 0, 0};
  image.at(5, 0) = {.9999f, 0, 0};
  const auto back = decode(written(image));
  ASSERT_TRUE(back);
  EXPECT_EQ(back->pixels.at(0, 0), (Rgb{0, 2, 0}));
  EXPECT_EQ(back->pixels.at(1, 0), (Rgb{0, 1, 0}));
  EXPECT_EQ(back->pixels.at(2, 0), (Rgb{largest, 0, 0}));
  EXPECT_EQ(back->pixels.at(3, 0), (Rgb{0, 0, 0}));
  EXPECT_EQ(back->pixels.at(4, 0), (Rgb{largest, 0, 0}));
  EXPECT_EQ(back->pixels.at(5, 0), (Rgb{1, 0, 0})) << "rounding carries into the exponent";
  EXPECT_EQ(back->non_finite, 0u);
}

TEST(Radiance, LinesBeforeTheMagicAreTolerated) {
  EXPECT_TRUE(decode("VIEW= -vtv -vh 90\n" + kHeader + "-Y 1 +X 1\n" + flat({1})));
  EXPECT_TRUE(decode(std::string(4000, 'v') + "\n" + kHeader + "-Y 1 +X 1\n" + flat({1})));
  EXPECT_FALSE(decode(std::string(5000, 'v') + "\n" + kHeader + "-Y 1 +X 1\n" + flat({1})));
  EXPECT_FALSE(decode("VIEW=#?RADIANCE\n\n-Y 1 +X 1\n" + flat({1}))) << "not at a line's start";
}

TEST(Radiance, EightOrientationsPutPixelsWhereTheySay) {
  using Row = std::vector<float>;
  const auto read = [](const std::string& resolution) {
    const auto image = decode(kHeader + resolution + "\n" + flat({1, 2, 3, 4, 5, 6}));
    EXPECT_TRUE(image) << resolution;
    EXPECT_EQ(image->pixels.width(), 3) << resolution;
    EXPECT_EQ(image->pixels.height(), 2) << resolution;
    return reds(*image);
  };
  EXPECT_EQ(read("-Y 2 +X 3"), (Row{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(read("-Y 2 -X 3"), (Row{3, 2, 1, 6, 5, 4}));
  EXPECT_EQ(read("+Y 2 +X 3"), (Row{4, 5, 6, 1, 2, 3}));
  EXPECT_EQ(read("+Y 2 -X 3"), (Row{6, 5, 4, 3, 2, 1}));
  EXPECT_EQ(read("+X 3 -Y 2"), (Row{1, 3, 5, 2, 4, 6}));
  EXPECT_EQ(read("-X 3 -Y 2"), (Row{5, 3, 1, 6, 4, 2}));
  EXPECT_EQ(read("+X 3 +Y 2"), (Row{2, 4, 6, 1, 3, 5}));
  EXPECT_EQ(read("-X 3 +Y 2"), (Row{6, 4, 2, 5, 3, 1}));
}

TEST(Radiance, OldRunsRepeatThePixelBeforeThem) {
  const std::string run_of_3{1, 1, 1, 3};
  const auto small = decode(kHeader + "-Y 1 +X 5\n" + flat({7}) + run_of_3 + flat({9}));
  ASSERT_TRUE(small) << small.error().detail;
  EXPECT_EQ(reds(*small), (std::vector<float>{7, 7, 7, 7, 9}));

  // 44 + (1 << 8) = 300: consecutive runs are the bytes of one count.
  const std::string run_of_300{1, 1, 1, 44, 1, 1, 1, 1};
  const auto wide = decode(kHeader + "-Y 1 +X 302\n" + flat({7}) + run_of_300 + flat({9}));
  ASSERT_TRUE(wide) << wide.error().detail;
  EXPECT_EQ(wide->pixels.at(300, 0).r, 7);
  EXPECT_EQ(wide->pixels.at(301, 0).r, 9);
}

TEST(Radiance, RunsMustNotLeaveTheirScanLine) {
  const std::string run_of_3{1, 1, 1, 3};
  EXPECT_FALSE(decode(kHeader + "-Y 1 +X 3\n" + flat({7}) + run_of_3 + flat({1, 1, 1})));
  EXPECT_FALSE(decode(kHeader + "-Y 2 +X 4\n" + run_of_3 + flat({1, 1, 1, 1, 1, 1, 1, 1})));
  const std::string new_run{2, 2, 0, 8, static_cast<char>(128 + 9), 5};
  const auto over = decode(kHeader + "-Y 1 +X 8\n" + new_run + std::string(64, '\x05'));
  ASSERT_FALSE(over);
  EXPECT_EQ(over.error().code, ErrorCode::kUnreadable);
  EXPECT_NE(over.error().detail.find("byte 49"), std::string::npos) << over.error().detail;
  const std::string empty_literal{2, 2, 0, 8, 0, 0};
  EXPECT_FALSE(decode(kHeader + "-Y 1 +X 8\n" + empty_literal + std::string(64, '\0')));
  const std::string other_width{2, 2, 0, 9};
  EXPECT_FALSE(decode(kHeader + "-Y 1 +X 8\n" + other_width + std::string(64, '\x01')));
}

TEST(Radiance, ExposureAndColourCorrectionAreDividedOut) {
  const auto image =
      decode("#?RADIANCE\nEXPOSURE=2\nFORMAT=32-bit_rle_rgbe\nEXPOSURE= +4.0\n" +
             std::string("COLORCORR= 0.5 1 1\n\tEXPOSURE=100\n\n-Y 1 +X 1\n") + flat({64}));
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->pixels.at(0, 0).r,
            16);  // a line that starts with a blank belongs to another picture
  for (const char* bad : {"EXPOSURE=0", "EXPOSURE=-1", "EXPOSURE=nan", "EXPOSURE=inf", "EXPOSURE=x",
                          "EXPOSURE=", "COLORCORR=1 2", "COLORCORR=1 0 1", "EXPOSURE=1e999"})
    EXPECT_FALSE(decode("#?RADIANCE\n" + std::string(bad) + "\n\n-Y 1 +X 1\n" + flat({1}))) << bad;
}

TEST(Radiance, OverflowThroughExposureIsCounted) {
  const auto image = decode("#?RADIANCE\nEXPOSURE=1e-30\n\n-Y 1 +X 2\n" +
                            std::string{'\xff', 0, 0, '\xff', '\x01', 0, 0, '\x80'});
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->non_finite, 1u);
}

TEST(Radiance, XyzBecomesRec709) {
  // D65 white, XYZ = (.9505, 1, 1.0891), in codes of 1/128.
  const auto image =
      decode("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n" +
             std::string{122, static_cast<char>(128), static_cast<char>(139), '\x81'});
  ASSERT_TRUE(image) << image.error().detail;
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(image->pixels.at(0, 0)[c], 1, .02);
}

TEST(Radiance, DeclaredPrimariesAreConvertedAndUnsetOnesIgnored) {
  const auto read = [](const std::string& xy) {
    return decode("#?RADIANCE\nPRIMARIES=" + xy + "\n\n-Y 1 +X 1\n" +
                  std::string{64, 64, 64, '\x88'});
  };
  const auto unset = read("0 0 0 0 0 0 0 0");
  ASSERT_TRUE(unset);
  EXPECT_EQ(unset->pixels.at(0, 0), (Rgb{64, 64, 64}));
  const auto rec709 = read(".64 .33 .3 .6 .15 .06 .3127 .329");
  ASSERT_TRUE(rec709);
  EXPECT_EQ(rec709->pixels.at(0, 0), (Rgb{64, 64, 64}));
  const auto wide = read(".7347 .2653 0 1 .0001 -.077 .3127 .329");
  ASSERT_TRUE(wide);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(wide->pixels.at(0, 0)[c], 64, 1e-3) << "the same white";
  EXPECT_FALSE(read("1 2 3"));
  EXPECT_FALSE(read(".3 .3 .3 .3 .3 .3 .3 .3"));
}

TEST(Radiance, EveryTruncationIsAnErrorThatNamesItsByte) {
  const std::string whole = written(noise(12, 3, 5));
  ASSERT_TRUE(decode(whole));
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const std::vector<unsigned char> part(whole.begin(),
                                          whole.begin() + static_cast<std::ptrdiff_t>(size));
    const auto result = decode_radiance(part, "short.hdr");
    ASSERT_FALSE(result) << size;
    EXPECT_EQ(result.error().code, ErrorCode::kUnreadable) << size;
    EXPECT_EQ(result.error().where, "short.hdr");
    if (size > 10) {
      EXPECT_NE(result.error().detail.find("byte"), std::string::npos) << size;
    }
  }
}

TEST(Radiance, BytesAfterThePictureAreIgnored) {
  EXPECT_TRUE(decode(kHeader + "-Y 1 +X 1\n" + flat({1}) + "trailing"));
}

TEST(Radiance, HugeSizesAreRefusedBeforeAnythingIsAllocated) {
  for (const char* size :
       {"-Y 1000000000 +X 1000000000", "-Y 32769 +X 1", "-Y 1 +X 32769", "-Y 32768 +X 32768",
        "-Y 99999999999999999999999 +X 1", "-Y 4294967297 +X 4294967297"}) {
    const auto result = decode(kHeader + size + "\n" + flat({1}));
    ASSERT_FALSE(result) << size;
    EXPECT_EQ(result.error().code, ErrorCode::kInvalid) << size;
  }
}

TEST(Radiance, ImpossibleHeadersAreRefused) {
  for (const char* size : {"", "-Y 0 +X 1", "-Y -1 +X 1", "-Y 1", "-Y 1 +Y 1", "+Z 1 +X 1",
                           "Y 1 X 1", "-Y 1 +X 1 3", "-Y 1x +X 1", "-Y 1 +X"}) {
    const auto result = decode(kHeader + size + "\n" + flat({1, 1}));
    ASSERT_FALSE(result) << size;
    EXPECT_EQ(result.error().code, ErrorCode::kUnreadable) << size;
  }
  EXPECT_FALSE(decode("#?RADIANCE\nFORMAT=32-bit_rle_cmyk\n\n-Y 1 +X 1\n" + flat({1})));
  EXPECT_FALSE(decode("\x89PNG\r\n\x1a\n"));
  EXPECT_FALSE(decode(""));
}

TEST(Radiance, DamageNeverCrashes) {
  int errors = 0, pictures = 0;
  const auto run = [&](std::span<const unsigned char> bytes) {
    const auto result = decode_radiance(bytes, "damaged");
    ++(result ? pictures : errors);
    if (result) {
      EXPECT_FALSE(result->pixels.empty());
    }
  };
  const std::string planes = written(noise(20, 4, 7));
  const std::string old = kHeader + "+X 5 -Y 3\n" + flat({7, 8}) + std::string{1, 1, 1, 3} +
                          flat({1, 2, 3, 4, 5, 6, 7, 8, 9, 10});
  test::mutate_and_run(as_bytes(planes), 4000, 1, run);
  test::mutate_and_run(as_bytes(old), 4000, 2, run);
  EXPECT_GT(errors, 100);
  EXPECT_GT(pictures, 100);
}

TEST(Radiance, MemorialWithViewLineEqualsItsCleanCopy) {
  PENUMBRA_NEED_SHARED(original, "eval-only/stacks/memorial/memorial.hdr");
  PENUMBRA_NEED_SHARED(clean, "eval-only/stacks/memorial/memorial_hdrshop.hdr");
  const auto a = read_hdr(original);
  const auto b = read_hdr(clean);
  ASSERT_TRUE(a) << a.error().detail;
  ASSERT_TRUE(b) << b.error().detail;
  EXPECT_EQ(a->pixels.width(), 512);
  EXPECT_EQ(a->pixels.height(), 768);
  EXPECT_EQ(a->pixels, b->pixels);
}

TEST(Radiance, RealEnvironmentsHaveTheirKnownPeakAndRewriteExactly) {
  const std::pair<const char*, double> known[] = {{"envmaps/venice_sunset_1k.hdr", 2091},
                                                  {"envmaps/rustig_koppie_puresky_1k.hdr", 3.108e5},
                                                  {"envmaps/potsdamer_platz_1k.hdr", 10.94}};
  for (const auto& [name, peak] : known) {
    PENUMBRA_NEED_SHARED(path, name);
    const auto image = read_hdr(path);
    ASSERT_TRUE(image) << image.error().detail;
    EXPECT_EQ(image->pixels.width(), 1024);
    EXPECT_EQ(image->pixels.height(), 512);
    EXPECT_EQ(image->non_finite, 0u);
    float largest = 0;
    for (const Rgb& p : image->pixels.pixels()) largest = std::max(largest, luminance(p));
    EXPECT_NEAR(largest, peak, peak * 5e-4) << name;
    const auto again = decode(written(image->pixels));
    ASSERT_TRUE(again);
    EXPECT_EQ(again->pixels, image->pixels);
  }
}

}  // namespace
}  // namespace penumbra::codec
