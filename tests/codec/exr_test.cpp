#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
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

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// By arithmetic, so that the library under test is not its own judge.
float float_from_half(unsigned bits) {
  const unsigned exponent = bits >> 10 & 31;
  const auto mantissa = static_cast<float>(bits & 1023);
  float value = 0;
  if (exponent == 31)
    value = mantissa == 0 ? kInfinity : kNan;
  else if (exponent == 0)
    value = std::ldexp(mantissa, -24);
  else
    value = std::ldexp(mantissa + 1024, static_cast<int>(exponent) - 25);
  return std::copysign(value, bits & 0x8000 ? -1.f : 1.f);
}

// Bits, so that -0 is not 0; any NaN is a NaN.
bool same_value(float a, float b) {
  return (std::isnan(a) && std::isnan(b)) ||
         std::bit_cast<std::uint32_t>(a) == std::bit_cast<std::uint32_t>(b);
}

void expect_same(const Image<Rgb>& a, const Image<Rgb>& b) {
  ASSERT_TRUE(a.same_size(b));
  for (std::size_t i = 0; i < a.area(); ++i)
    for (int c = 0; c < 3; ++c)
      ASSERT_TRUE(same_value(a.pixels()[i][c], b.pixels()[i][c]))
          << "pixel " << i << " channel " << c << ": " << a.pixels()[i][c] << ", "
          << b.pixels()[i][c];
}

Image<Rgb> small_picture() {
  Image<Rgb> image(5, 3);
  for (std::size_t i = 0; i < image.area(); ++i) {
    const auto k = static_cast<float>(i);
    image.pixels()[i] = {k, .25f * k, -k};
  }
  return image;
}

class Exr : public testing::Test {
 protected:
  Result<HdrImage> round_trip(const Image<Rgb>& image, Depth depth,
                              std::optional<EnvironmentAttribute> environment = std::nullopt) {
    if (auto written = write_hdr(path_, image, depth, environment); !written)
      return std::unexpected(written.error());
    return read_hdr(path_);
  }
  std::string bytes_of(const Image<Rgb>& image) {
    EXPECT_TRUE(write_hdr(path_, image, Depth::kHalf));
    const auto bytes = read_bytes(path_);
    return bytes ? std::string(bytes->begin(), bytes->end()) : std::string();
  }
  Result<HdrImage> read(const std::string& bytes) {
    EXPECT_TRUE(write_bytes(path_, bytes));
    return read_hdr(path_);
  }

  TempFolder folder_;
  std::filesystem::path path_ = folder_.path() / "a.exr";
};

// Overwrites the value of an attribute, found by its name and type.
template <class T>
std::string patched(std::string bytes, const std::string& name, const std::string& type,
                    const std::vector<T>& value) {
  const std::string key = name + '\0' + type + '\0';
  const auto at = bytes.find(key);
  EXPECT_NE(at, std::string::npos);
  std::memcpy(bytes.data() + at + key.size() + 4, value.data(), value.size() * sizeof(T));
  return bytes;
}

// Renames B, G and R in the channel list; the order of names must stay alphabetical.
std::string with_channels(std::string bytes, const char* names) {
  const std::string key = std::string("channels") + '\0' + "chlist" + '\0';
  const auto at = bytes.find(key) + key.size() + 4;
  constexpr std::size_t kEntry = 18;  // name and its zero, type, linear, reserved, samplings
  for (std::size_t c = 0; c < 3; ++c) bytes[at + c * kEntry] = names[c];
  return bytes;
}

TEST_F(Exr, RoundTripKeepsEveryHalfValue) {
  Image<Rgb> image(256, 256);
  for (unsigned i = 0; i < 65536; ++i)
    image.pixels()[i] = {float_from_half(i), float_from_half(65535 - i),
                         float_from_half(i ^ 0x5555)};
  const auto back = round_trip(image, Depth::kHalf);
  ASSERT_TRUE(back) << back.error().detail;
  expect_same(back->pixels, image);
}

TEST_F(Exr, RoundTripKeepsFloatsBitForBit) {
  using Limits = std::numeric_limits<float>;
  Image<Rgb> image(3, 2);
  image.at(0, 0) = {Limits::max(), Limits::lowest(), Limits::min()};
  image.at(1, 0) = {Limits::denorm_min(), -Limits::denorm_min(), 1e-40f};
  image.at(2, 0) = {-0.f, 0.f, 1 + Limits::epsilon()};
  image.at(0, 1) = {kNan, kInfinity, -kInfinity};
  image.at(1, 1) = {.1f, 1.f / 3, 1e38f};
  const auto back = round_trip(image, Depth::kFloat);
  ASSERT_TRUE(back) << back.error().detail;
  expect_same(back->pixels, image);
  EXPECT_EQ(back->non_finite, 1u);
}

TEST_F(Exr, HalfKeepsABrightFiniteLightFinite) {
  const auto back = round_trip(Image<Rgb>(1, 1, {3e5f, -3e5f, kInfinity}), Depth::kHalf);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->pixels.at(0, 0), (Rgb{65504, -65504, kInfinity}));
}

TEST_F(Exr, CountsPixelsThatAreNotFinite) {
  Image<Rgb> image = small_picture();
  image.at(0, 0).r = kNan;
  image.at(1, 1) = {kInfinity, kNan, 0};
  image.at(4, 2).b = -kInfinity;
  const auto back = round_trip(image, Depth::kHalf);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->non_finite, 3u);
}

TEST_F(Exr, EnvironmentAttributeSurvivesAndIsAbsentOtherwise) {
  for (const auto kind : {EnvironmentAttribute::kLatLong, EnvironmentAttribute::kCube}) {
    const auto back = round_trip(small_picture(), Depth::kHalf, kind);
    ASSERT_TRUE(back);
    EXPECT_EQ(back->environment, kind);
  }
  const auto plain = round_trip(small_picture(), Depth::kHalf);
  ASSERT_TRUE(plain);
  EXPECT_FALSE(plain->environment);
}

TEST_F(Exr, AlphaComesBackAndIsAbsentOtherwise) {
  const auto path = folder_.path() / "alpha.exr";
  Image<float> alpha(5, 3);
  for (std::size_t i = 0; i < alpha.area(); ++i) alpha.pixels()[i] = static_cast<float>(i % 2);
  ASSERT_TRUE(write_hdr(path, small_picture(), Depth::kFloat, {}, alpha));
  const auto with = read_hdr(path);
  ASSERT_TRUE(with) << with.error().detail;
  EXPECT_EQ(with->alpha, alpha);
  expect_same(with->pixels, small_picture());
  ASSERT_TRUE(write_hdr(path, small_picture(), Depth::kFloat));
  EXPECT_TRUE(read_hdr(path)->alpha.empty());
  const auto hdr =
      write_hdr(folder_.path() / "alpha.hdr", small_picture(), Depth::kFloat, {}, alpha);
  ASSERT_FALSE(hdr);
  EXPECT_EQ(hdr.error().code, ErrorCode::kInvalid);
  EXPECT_FALSE(write_hdr(path, small_picture(), Depth::kFloat, {}, Image<float>(2, 2)));
}

TEST_F(Exr, DataWindowMayStartAnywhere) {
  const Image<Rgb> image = small_picture();
  for (const int x : {-100000, 7, 1000000000}) {
    const auto moved = read(patched<int>(bytes_of(image), "dataWindow", "box2i", {x, 0, x + 4, 2}));
    ASSERT_TRUE(moved) << x << ": " << moved.error().detail;
    expect_same(moved->pixels, image);
  }
}

TEST_F(Exr, LuminanceOrALoneChannelIsGrey) {
  const std::string bytes = bytes_of(small_picture());
  const auto luminance_only = read(with_channels(bytes, "BGY"));
  ASSERT_TRUE(luminance_only) << luminance_only.error().detail;
  EXPECT_EQ(luminance_only->pixels.at(4, 0), (Rgb{4, 4, 4}));
}

TEST_F(Exr, ChannelsWithoutColourAreNamedInTheError) {
  const auto result = read(with_channels(bytes_of(small_picture()), "BGQ"));
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kUnreadable);
  EXPECT_NE(result.error().detail.find("B G Q"), std::string::npos) << result.error().detail;
}

TEST_F(Exr, OtherPrimariesBecomeRec709) {
  // CIE XYZ, whose white is (1/3, 1/3): Rec.709 white has x / y, 1, z / y of D65.
  const Image<Rgb> white(2, 2, {.3127f / .3290f, 1, .3583f / .3290f});
  const auto xyz = read(patched<float>(bytes_of(white), "chromaticities", "chromaticities",
                                       {1, 0, 0, 1, 0, 0, 1.f / 3, 1.f / 3}));
  ASSERT_TRUE(xyz) << xyz.error().detail;
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(xyz->pixels.at(1, 1)[c], 1, 2e-3);

  const auto none = read(patched<float>(bytes_of(white), "chromaticities", "chromaticities",
                                        std::vector<float>(8, 0)));
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kUnreadable);
  EXPECT_FALSE(read(patched<float>(bytes_of(white), "chromaticities", "chromaticities",
                                   std::vector<float>(8, kNan))));
}

TEST_F(Exr, EveryTruncationIsAnErrorThatNamesTheFile) {
  const std::string whole = bytes_of(small_picture());
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const auto result = read(whole.substr(0, size));
    ASSERT_FALSE(result) << size;
    EXPECT_EQ(result.error().code, ErrorCode::kUnreadable) << size;
    EXPECT_EQ(result.error().where, path_.string());
    EXPECT_FALSE(result.error().detail.empty());
  }
}

TEST_F(Exr, HugeWindowsAreRefusedBeforeAnythingIsAllocated) {
  constexpr int kLowest = std::numeric_limits<int>::min(),
                kHighest = std::numeric_limits<int>::max();
  const std::string bytes = bytes_of(small_picture());
  const std::vector<int> windows[] = {{0, 0, 999999999, 999999999},
                                      {0, 0, 32768, 0},
                                      {0, 0, 0, 32768},
                                      {0, 0, 32767, 32767},
                                      {kLowest, kLowest, kHighest, kHighest},
                                      {kLowest, 0, -1, 0}};
  for (const auto& window : windows) {
    const auto result = read(patched(bytes, "dataWindow", "box2i", window));
    ASSERT_FALSE(result) << window[2];
    EXPECT_EQ(result.error().code, ErrorCode::kInvalid) << result.error().detail;
  }
  const auto inverted = read(patched<int>(bytes, "dataWindow", "box2i", {0, 0, -5, 2}));
  ASSERT_FALSE(inverted);
  EXPECT_EQ(inverted.error().code, ErrorCode::kUnreadable);
}

TEST_F(Exr, AttributesLargerThanTheFileAreRefused) {
  std::string bytes = bytes_of(small_picture());
  const auto at = bytes.find(std::string("compression") + '\0' + "compression" + '\0') + 24;
  for (const int size : {0x7fffffff, -1, 1 << 20}) {
    std::memcpy(bytes.data() + at, &size, sizeof size);
    const auto result = read(bytes);
    ASSERT_FALSE(result) << size;
    EXPECT_EQ(result.error().code, ErrorCode::kUnreadable);
  }
}

TEST_F(Exr, DamageNeverCrashes) {
  const std::string whole = bytes_of(small_picture());
  int errors = 0;
  test::mutate_and_run({reinterpret_cast<const unsigned char*>(whole.data()), whole.size()}, 300,
                       11, [&](std::span<const unsigned char> bytes) {
                         errors += !read(std::string(bytes.begin(), bytes.end()));
                       });
  EXPECT_GT(errors, 50);
}

TEST_F(Exr, ReadingTellsWhyNot) {
  const auto code = [](const Result<HdrImage>& result) {
    return result ? std::optional<ErrorCode>() : result.error().code;
  };
  EXPECT_EQ(code(read_hdr(folder_.path() / "absent.exr")), ErrorCode::kNotFound);
  EXPECT_EQ(code(read_hdr(folder_.path())), ErrorCode::kUnreadable);
  EXPECT_EQ(code(read("")), ErrorCode::kUnreadable);
  EXPECT_EQ(code(read("not a picture")), ErrorCode::kUnreadable);
  EXPECT_EQ(code(read(std::string(1000, '\0'))), ErrorCode::kUnreadable);
}

TEST_F(Exr, KindIsFoundByContent) {
  const auto disguised = folder_.path() / "a.hdr";
  ASSERT_TRUE(write_bytes(disguised, bytes_of(small_picture())));
  const auto image = read_hdr(disguised);
  ASSERT_TRUE(image) << image.error().detail;
  expect_same(image->pixels, small_picture());
}

TEST_F(Exr, UnwritableOutputLeavesNothing) {
  const auto code = [](const Result<void>& result) {
    return result ? std::optional<ErrorCode>() : result.error().code;
  };
  const Image<Rgb> image = small_picture();
  for (const char* extension : {"exr", "hdr"}) {
    const TempFolder folder;
    const auto name = std::string("a.") + extension;
    EXPECT_EQ(code(write_hdr(folder.path() / "absent" / name, image)), ErrorCode::kUnwritable);
    EXPECT_EQ(code(write_hdr(folder.path() / name, Image<Rgb>())), ErrorCode::kInvalid);
    EXPECT_TRUE(folder.empty());
    ASSERT_TRUE(make_folder(folder.path() / name));
    EXPECT_EQ(code(write_hdr(folder.path() / name, image)), ErrorCode::kUnwritable);
    EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1);
  }
  EXPECT_EQ(code(write_hdr(folder_.path() / "a.png", image)), ErrorCode::kInvalid);
  EXPECT_EQ(code(write_hdr(folder_.path() / "a", image)), ErrorCode::kInvalid);
  EXPECT_EQ(code(write_hdr(path_, Image<Rgb>(40000, 1))), ErrorCode::kInvalid);
  EXPECT_TRUE(folder_.empty());
}

// Real pictures.

TEST_F(Exr, AllHalfValuesAreAllThere) {
  PENUMBRA_NEED_SHARED(path, "hdr-images/AllHalfValues.exr");
  const auto image = read_hdr(path);
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->non_finite, 2048u);
  std::vector<std::uint32_t> expected, found;
  for (unsigned i = 0; i < 65536; ++i)
    if ((i >> 10 & 31) != 31) expected.push_back(std::bit_cast<std::uint32_t>(float_from_half(i)));
  for (const Rgb& p : image->pixels.pixels())
    if (std::isfinite(p.r)) found.push_back(std::bit_cast<std::uint32_t>(p.r));
  std::ranges::sort(expected);
  std::ranges::sort(found);
  EXPECT_EQ(found, expected);
}

TEST_F(Exr, BrightRingsHaveTwelveBadPixels) {
  PENUMBRA_NEED_SHARED(path, "hdr-images/BrightRingsNanInf.exr");
  const auto image = read_hdr(path);
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->non_finite, 12u);
}

TEST_F(Exr, XyzPictureEqualsItsRec709Twin) {
  PENUMBRA_NEED_SHARED(xyz_path, "hdr-images/XYZ.exr");
  PENUMBRA_NEED_SHARED(rgb_path, "hdr-images/Rec709.exr");
  const auto xyz = read_hdr(xyz_path);
  const auto rgb = read_hdr(rgb_path);
  ASSERT_TRUE(xyz) << xyz.error().detail;
  ASSERT_TRUE(rgb) << rgb.error().detail;
  ASSERT_TRUE(xyz->pixels.same_size(rgb->pixels));
  // Both files hold halves, of 11 bits; the matrix's row for red has entries up to 3.2.
  for (std::size_t i = 0; i < rgb->pixels.area(); ++i) {
    const Rgb a = xyz->pixels.pixels()[i], b = rgb->pixels.pixels()[i];
    for (int c = 0; c < 3; ++c)
      ASSERT_LE(std::abs(a[c] - b[c]), 2.5e-3 * std::max({b.r, b.g, b.b})) << i;
  }
}

TEST_F(Exr, LuminanceChromaKeepsTheStoredLuminance) {
  PENUMBRA_NEED_SHARED(path, "hdr-images/Flowers.exr");
  const auto image = read_hdr(path);
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->pixels.width(), 784);
  EXPECT_EQ(image->pixels.height(), 734);
  EXPECT_EQ(image->non_finite, 0u);
  float low = kInfinity, high = 0, colour = 0;
  for (const Rgb& p : image->pixels.pixels()) {
    low = std::min(low, luminance(p));
    high = std::max(high, luminance(p));
    colour = std::max(colour, std::abs(p.r - p.b));
  }
  // The extremes of the file's Y channel.
  EXPECT_NEAR(low, .015625, 1e-4);
  EXPECT_NEAR(high, 4.25, 1e-2);
  EXPECT_GT(colour, .5);
}

TEST_F(Exr, TiledPictureIsRead) {
  PENUMBRA_NEED_SHARED(path, "hdr-images/GoldenGate.exr");
  const auto image = read_hdr(path);
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->pixels.width(), 1262);
  EXPECT_EQ(image->pixels.height(), 860);
  float high = 0;
  for (const Rgb& p : image->pixels.pixels()) high = std::max(high, luminance(p));
  EXPECT_NEAR(high, 292.3, .1);
}

TEST_F(Exr, KernerEnvironmentsSayWhatTheyAre) {
  PENUMBRA_NEED_SHARED(latlong_path, "envmaps/KernerEnvLatLong.exr");
  PENUMBRA_NEED_SHARED(cube_path, "envmaps/KernerEnvCube.exr");
  const auto latlong = read_hdr(latlong_path);
  const auto cube = read_hdr(cube_path);
  ASSERT_TRUE(latlong) << latlong.error().detail;
  ASSERT_TRUE(cube) << cube.error().detail;
  EXPECT_EQ(latlong->environment, EnvironmentAttribute::kLatLong);
  EXPECT_EQ(cube->environment, EnvironmentAttribute::kCube);
  EXPECT_EQ(latlong->pixels.width(), 1024);  // level 0 of a mip-mapped file
  EXPECT_EQ(cube->pixels.height(), 6 * cube->pixels.width());
}

TEST_F(Exr, FullFloatRangeIsNotClampedToHalf) {
  PENUMBRA_NEED_SHARED(path, "hdr-images/WideFloatRange.exr");
  const auto image = read_hdr(path);
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->non_finite, 0u);
  float low = kInfinity, high = 0;
  for (const Rgb& p : image->pixels.pixels()) {
    ASSERT_TRUE(p.r == p.g && p.g == p.b) << "one channel, so grey";
    if (p.g > 0) low = std::min(low, p.g);
    high = std::max(high, p.g);
  }
  EXPECT_GT(high, 1e38f);
  EXPECT_LT(low, std::numeric_limits<float>::min()) << "denormals too";
  const auto back = round_trip(image->pixels, Depth::kFloat);
  ASSERT_TRUE(back);
  expect_same(back->pixels, image->pixels);
}

TEST_F(Exr, OnlyTheDataWindowOfAPlainLayerIsRead) {
  PENUMBRA_NEED_SHARED(path, "hdr-sequence/beachball/singlepart.0001.exr");
  const auto image = read_hdr(path);
  ASSERT_TRUE(image) << image.error().detail;
  EXPECT_EQ(image->pixels.width(), 911);
  EXPECT_EQ(image->pixels.height(), 876);
}

}  // namespace
}  // namespace penumbra::codec
