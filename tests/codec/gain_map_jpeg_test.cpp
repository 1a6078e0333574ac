#include "codec/gain_map_jpeg.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "codec/codec.h"
#include "codec/display.h"
#include "tests/fuzz/mutate.h"

namespace penumbra::codec {
namespace {

using Bytes = std::vector<unsigned char>;

std::size_t u32(const Bytes& bytes, std::size_t at) {
  return std::size_t{bytes[at]} << 24 | std::size_t{bytes[at + 1]} << 16 |
         std::size_t{bytes[at + 2]} << 8 | bytes[at + 3];
}

std::size_t find(const Bytes& bytes, const std::string& text, std::size_t from = 0) {
  const auto found = std::search(bytes.begin() + static_cast<std::ptrdiff_t>(from), bytes.end(),
                                 text.begin(), text.end());
  return found == bytes.end() ? 0 : static_cast<std::size_t>(found - bytes.begin());
}

double number_after(const Bytes& bytes, const std::string& name) {
  const std::size_t at = find(bytes, name + "=\"");
  return std::stod(std::string(bytes.begin() + static_cast<std::ptrdiff_t>(at + name.size() + 2),
                               bytes.begin() + static_cast<std::ptrdiff_t>(at + name.size() + 20)));
}

float linear(std::uint8_t code) {
  const float v = static_cast<float>(code) / 255;
  return v <= .04045f ? v / 12.92f : std::pow((v + .055f) / 1.055f, 2.4f);
}

// From dark to a sun, in two hues.
Image<Rgb> ramp() {
  Image<Rgb> out(256, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 256; ++x) {
      const float level = std::exp2(-4 + 16 * static_cast<float>(x) / 255);
      out.at(x, y) = y < 32 ? Rgb{level, level, level} : Rgb{level, .5f * level, .25f * level};
    }
  return out;
}

// As a tone mapper makes it: all channels of a pixel brought down alike, highlights to white.
Image<Rgb8> base_of(const Image<Rgb>& radiance) {
  Image<Rgb> shown(radiance.width(), radiance.height());
  for (std::size_t i = 0; i < shown.area(); ++i) {
    const Rgb& c = radiance.pixels()[i];
    const float most = std::max({c.r, c.g, c.b});
    shown.pixels()[i] = c * (1 / (1 + most));
  }
  return to_display(FramePixels(shown));
}

// RMS over all pixels and channels, and of what all send together.
struct RelErrors {
  double rms = 0, total = 0;
};
RelErrors rel_errors(const Image<Rgb>& got, const Image<Rgb>& truth) {
  double squares = 0, sum = 0, true_sum = 0;
  for (std::size_t i = 0; i < truth.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double should = truth.pixels()[i][c], is = got.pixels()[i][c];
      squares += (is - should) * (is - should) / (should * should);
      sum += is, true_sum += should;
    }
  return {std::sqrt(squares / (3. * double(truth.area()))), std::abs(sum / true_sum - 1)};
}

// As a viewer does: the index tells the second picture, its metadata the gains.
TEST(GainMapJpeg, AViewerGetsTheRadianceBack) {
  const Image<Rgb> truth = ramp();
  const auto made = encode_gain_map_jpeg(truth, base_of(truth), 95);
  ASSERT_TRUE(made);
  const std::size_t index = find(*made, std::string("MPF\0", 4)) + 4;
  ASSERT_GT(index, 4u);
  ASSERT_EQ(std::string(made->begin() + static_cast<std::ptrdiff_t>(index),
                        made->begin() + static_cast<std::ptrdiff_t>(index) + 2),
            "MM");
  const std::size_t entries = index + u32(*made, index + 8 + 2 + 2 * 12 + 8);
  const std::size_t first_size = u32(*made, entries + 4),
                    second_size = u32(*made, entries + 16 + 4),
                    second_at = index + u32(*made, entries + 16 + 8);
  ASSERT_EQ(second_at, first_size);
  ASSERT_EQ(second_at + second_size, made->size());
  EXPECT_EQ(number_after(*made, "Item:Length"), static_cast<double>(second_size));
  const Bytes second(made->begin() + static_cast<std::ptrdiff_t>(second_at), made->end());
  const auto base = decode_frame(std::span(*made).first(first_size), "base");
  const auto gains = decode_frame(second, "gains");
  ASSERT_TRUE(base && gains);
  const auto& shown = std::get<Image<Rgb8>>(*base);
  const auto& map = std::get<Image<Rgb8>>(*gains);
  const double most = number_after(second, "hdrgm:GainMapMax"),
               least = number_after(second, "hdrgm:GainMapMin"),
               offset = number_after(second, "hdrgm:OffsetSDR"),
               exposure = number_after(*made, "penumbra:Exposure");
  EXPECT_EQ(number_after(second, "hdrgm:HDRCapacityMax"), most);
  EXPECT_LT(least, 0) << "as much lies below the base as above it";
  Image<Rgb> got(256, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 256; ++x) {
      const Rgb8 b = shown.at(x, y), g = map.at(x, y);
      const auto lit = [&](std::uint8_t of_base, std::uint8_t of_map) {
        const double gain = std::exp2(least + (most - least) * of_map / 255.);
        return static_cast<float>(((linear(of_base) + offset) * gain - offset) / exposure);
      };
      got.at(x, y) = {lit(b.r, g.r), lit(b.g, g.g), lit(b.b, g.b)};
    }
  const double step = (most - least) / 255;  // stops
  EXPECT_LT(rel_errors(got, truth).rms, .7 * step);
  EXPECT_LT(rel_errors(got, truth).total, .005);
  // And ours, by what ISO 21496-1 says of the same file.
  const auto ours = decode_gain_map_jpeg(*made, "ramp");
  ASSERT_TRUE(ours) << ours.error().detail;
  EXPECT_LT(rel_errors(ours->pixels, truth).rms, .7 * step);
  EXPECT_LT(rel_errors(ours->pixels, truth).total, .005);
  EXPECT_TRUE(has_gain_map(*made));
  EXPECT_FALSE(has_gain_map(std::span(*made).first(first_size)));
}

TEST(GainMapJpeg, ADarkPictureComesBackAndBadOnesAreRefused) {
  Image<Rgb> dark(16, 16);
  std::ranges::fill(dark.pixels(), Rgb{.1f, .1f, .1f});
  const auto made = encode_gain_map_jpeg(dark, base_of(dark));
  ASSERT_TRUE(made);
  EXPECT_NEAR(decode_gain_map_jpeg(*made, "dark")->pixels.at(5, 5).g, .1, 2e-3);
  const Image<Rgb> black(16, 16);
  const auto none = encode_gain_map_jpeg(black, base_of(black));
  ASSERT_TRUE(none);
  EXPECT_EQ(decode_gain_map_jpeg(*none, "black")->pixels.at(5, 5), Rgb());
  EXPECT_EQ(encode_gain_map_jpeg({}, {}).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(encode_gain_map_jpeg(dark, Image<Rgb8>(8, 16)).error().code, ErrorCode::kInvalid);
  dark.at(3, 4).g = std::nanf("");
  const auto bad = encode_gain_map_jpeg(dark, Image<Rgb8>(16, 16));
  ASSERT_FALSE(bad);
  EXPECT_EQ(bad.error().code, ErrorCode::kNonFinite);
  EXPECT_NE(bad.error().detail.find("3, 4"), std::string::npos);
}

// -------------------------------------------------------------------------- files by other makers

Bytes segment(unsigned char marker, const std::string& data) {
  const std::size_t size = data.size() + 2;
  Bytes out{0xff, marker, static_cast<unsigned char>(size >> 8), static_cast<unsigned char>(size)};
  out.insert(out.end(), data.begin(), data.end());
  return out;
}

Bytes with_segment(const Bytes& jpeg, const Bytes& segment) {
  Bytes out = jpeg;
  out.insert(out.begin() + 2, segment.begin(), segment.end());
  return out;
}

std::string xmp(const std::string& inner) {
  return std::string("http://ns.adobe.com/xap/1.0/\0", 29) + "<x:xmpmeta><rdf:RDF>" + inner +
         "</rdf:RDF></x:xmpmeta>";
}

// Without an index of pictures: the base's XMP tells where the map begins.
Bytes file_of(const Bytes& base, const Bytes& gains) {
  const Bytes head = segment(0xe1, xmp("<Container:Item Item:Semantic=\"Primary\"/><Container:Item "
                                       "Item:Semantic=\"GainMap\" Item:Length=\"" +
                                       std::to_string(gains.size()) + "\"/>"));
  Bytes out = with_segment(base, head);
  out.insert(out.end(), gains.begin(), gains.end());
  return out;
}

Image<Rgb8> even(int width, int height, Rgb8 colour) {
  Image<Rgb8> out(width, height);
  std::ranges::fill(out.pixels(), colour);
  return out;
}

Bytes jpeg_of(const Image<Rgb8>& picture) {
  return *encode_jpeg(picture, 100);
}

TEST(GainMapJpeg, ASmallerMapWithAGammaAndAListForEachChannelIsFollowed) {
  const std::string metadata =
      "<rdf:Description hdrgm:Version=\"1.0\" hdrgm:Gamma=\"2\" hdrgm:OffsetSDR=\"0\" "
      "hdrgm:OffsetHDR=\"0\"><hdrgm:GainMapMin><rdf:Seq><rdf:li>0</rdf:li><rdf:li>1</rdf:li>"
      "<rdf:li>-1</rdf:li></rdf:Seq></hdrgm:GainMapMin><hdrgm:GainMapMax><rdf:Seq><rdf:li>2"
      "</rdf:li><rdf:li>3</rdf:li><rdf:li>4</rdf:li></rdf:Seq></hdrgm:GainMapMax>";
  const Bytes gains = with_segment(jpeg_of(even(8, 4, {64, 64, 64})), segment(0xe1, xmp(metadata)));
  const auto got =
      decode_gain_map_jpeg(file_of(jpeg_of(even(32, 16, {188, 188, 188})), gains), "file");
  ASSERT_TRUE(got) << got.error().detail;
  EXPECT_EQ(got->pixels.width(), 32);
  const double part = std::sqrt(64 / 255.), base = linear(188);
  const Rgb& c = got->pixels.at(20, 9);
  EXPECT_NEAR(c.r, base * std::exp2(2 * part), .02 * c.r);
  EXPECT_NEAR(c.g, base * std::exp2(1 + 2 * part), .02 * c.g);
  EXPECT_NEAR(c.b, base * std::exp2(-1 + 5 * part), .02 * c.b);
  // With languages on the items, and bytes of somebody else's behind the map.
  std::string spoken = metadata;
  for (std::size_t at = spoken.find("<rdf:li>"); at != std::string::npos;
       at = spoken.find("<rdf:li>", at + 1))
    spoken.insert(at + 7, " xml:lang=\"x-default\"");
  Bytes file = file_of(jpeg_of(even(32, 16, {188, 188, 188})),
                       with_segment(jpeg_of(even(8, 4, {64, 64, 64})), segment(0xe1, xmp(spoken))));
  const std::string more = "a maker's notes";
  file.insert(file.end(), more.begin(), more.end());
  const auto other = decode_gain_map_jpeg(file, "file");
  ASSERT_TRUE(other) << other.error().detail;
  EXPECT_EQ(other->pixels.at(20, 9), c);
}

std::string be32(std::uint32_t value) {
  std::string out;
  for (const int shift : {24, 16, 8, 0}) out += static_cast<char>(value >> shift);
  return out;
}

// The standard's metadata; of each value a denominator, or one for all.
std::string iso(unsigned char flags, const std::vector<int>& values, int version = 0) {
  std::string out("urn:iso:std:iso:ts:21496:-1\0", 28);
  out += {'\0', static_cast<char>(version), '\0', '\0', static_cast<char>(flags)};
  const bool common = (flags & 8) != 0;
  if (common) out += be32(100);
  for (const int v : values) out += be32(static_cast<std::uint32_t>(v)) + (common ? "" : be32(100));
  return out;
}

Result<HdrImage> decoded(const Bytes& base, const Bytes& gains) {
  return decode_gain_map_jpeg(file_of(base, gains), "file");
}

TEST(GainMapJpeg, TheStandardsMetadataCountsBeforeXmp) {
  const Bytes grey = jpeg_of(even(16, 16, {188, 188, 188})),
              full = with_segment(jpeg_of(even(16, 16, {255, 255, 255})),
                                  segment(0xe1, xmp("<rdf:Description hdrgm:GainMapMax='1'/>")));
  const auto of = [&](const std::string& metadata) {
    return decoded(grey, with_segment(full, segment(0xe2, metadata)));
  };
  const std::vector<int> headroom{0, 300}, red{-100, 300, 100, 0, 0}, green{0, 200, 100, 0, 0},
      blue{0, 100, 200, 0, 0};
  const auto together = [](std::initializer_list<std::vector<int>> parts) {
    std::vector<int> out;
    for (const auto& p : parts) out.insert(out.end(), p.begin(), p.end());
    return out;
  };
  for (const unsigned char flags : {0x40, 0x48}) {
    const auto got = of(iso(flags, together({headroom, red})));
    ASSERT_TRUE(got) << got.error().detail;
    EXPECT_NEAR(got->pixels.at(8, 8).g, 8 * linear(188), .05) << int{flags};
  }
  const auto apart = of(iso(0xc0, together({headroom, red, green, blue})));
  ASSERT_TRUE(apart) << apart.error().detail;
  EXPECT_NEAR(apart->pixels.at(8, 8).r, 8 * linear(188), .05);
  EXPECT_NEAR(apart->pixels.at(8, 8).g, 4 * linear(188), .03);
  EXPECT_NEAR(apart->pixels.at(8, 8).b, 2 * linear(188), .02);
  const auto later = of(iso(0x40, together({headroom, red}), 1));
  ASSERT_TRUE(later) << "what XMP says is left";
  EXPECT_NEAR(later->pixels.at(8, 8).g, 2 * linear(188), .05);
  const auto brighter = of(iso(0x40, together({{300, 0}, red})));
  ASSERT_FALSE(brighter);
  EXPECT_NE(brighter.error().detail.find("brighter"), std::string::npos);
}

// Phones film in Display P3; its red is out of Rec.709's.
TEST(GainMapJpeg, ABaseInDisplayP3ComesInRec709) {
  const auto fixed = [](double v) {
    return be32(static_cast<std::uint32_t>(std::lround(v * 65536)));
  };
  std::string icc(128, '\0'), data;
  const std::array<std::array<double, 3>, 3> colorants{
      {{.51512, .24120, -.00105}, {.29198, .69225, .04189}, {.15710, .06657, .78407}}};
  icc += be32(3);
  for (std::size_t c = 0; c < 3; ++c) {
    icc += std::string(1, "rgb"[c]) + "XYZ" + be32(static_cast<std::uint32_t>(168 + 20 * c)) +
           be32(20);
    data += "XYZ " + be32(0);
    for (const double v : colorants[c]) data += fixed(v);
  }
  const Bytes profile = segment(0xe2, std::string("ICC_PROFILE\0", 12) + "\x01\x01" + icc + data);
  const Bytes gains = with_segment(
      jpeg_of(even(16, 16, {255, 255, 255})),
      segment(0xe1, xmp("<rdf:Description hdrgm:GainMapMax=\"1\" hdrgm:OffsetSDR=\"0\" "
                        "hdrgm:OffsetHDR=\"0\"/>")));
  const auto grey = decode_gain_map_jpeg(
      file_of(with_segment(jpeg_of(even(16, 16, {188, 188, 188})), profile), gains), "grey");
  ASSERT_TRUE(grey) << grey.error().detail;
  for (int c = 0; c < 3; ++c)
    EXPECT_NEAR(grey->pixels.at(8, 8)[c], 2 * linear(188), .01) << "white stays white";
  // source: linear Display P3 (1, 0, 0) in linear Rec.709, CSS Color 4: 1.2249, -.0420, -.0197
  const auto red = decode_gain_map_jpeg(
      file_of(with_segment(jpeg_of(even(16, 16, {255, 0, 0})), profile), gains), "red");
  ASSERT_TRUE(red);
  EXPECT_NEAR(red->pixels.at(8, 8).r, 2 * 1.2249, .03) << "JPEG's red is 254";
  EXPECT_EQ(red->pixels.at(8, 8).g, 0) << "no light is negative";
  // Gains in the primaries of a map without a profile.
  const auto mixed =
      decoded(with_segment(jpeg_of(even(16, 16, {255, 0, 0})), profile),
              with_segment(gains, segment(0xe2, iso(0, {0, 100, 0, 100, 100, 0, 0}))));
  ASSERT_FALSE(mixed);
  EXPECT_NE(mixed.error().detail.find("primaries"), std::string::npos);
}

std::string fixed16(double v) {
  return be32(static_cast<std::uint32_t>(static_cast<std::int32_t>(std::lround(v * 65536))));
}

// Of Rec.709 with one curve for all channels.
Bytes profile_with_curve(const std::string& curve) {
  constexpr std::array<std::array<double, 3>, 3> colorants{
      {{.43607, .22250, .01393}, {.38506, .71688, .09710}, {.14308, .06062, .71417}}};
  std::string icc(128, '\0'), data;
  const auto begin = static_cast<std::uint32_t>(128 + 4 + 6 * 12);
  icc += be32(6);
  for (std::size_t c = 0; c < 3; ++c) {
    icc += std::string(1, "rgb"[c]) + "XYZ" +
           be32(begin + static_cast<std::uint32_t>(data.size())) + be32(20);
    data += "XYZ " + be32(0);
    for (const double v : colorants[c]) data += fixed16(v);
  }
  for (const char channel : {'r', 'g', 'b'})
    icc += std::string(1, channel) + "TRC" + be32(begin + static_cast<std::uint32_t>(data.size())) +
           be32(static_cast<std::uint32_t>(curve.size()));
  return segment(0xe2, std::string("ICC_PROFILE\0", 12) + "\x01\x01" + icc + data + curve);
}

// Taken for sRGB, a picture of gamma 1.8 is a third off in the middle.
TEST(GainMapJpeg, TheToneCurveOfTheBasesProfileIsFollowed) {
  const Bytes gains = with_segment(
      jpeg_of(even(16, 16, {255, 255, 255})),
      segment(0xe1, xmp("<rdf:Description hdrgm:GainMapMax=\"1\" hdrgm:OffsetSDR=\"0\" "
                        "hdrgm:OffsetHDR=\"0\"/>")));
  const auto lit = [&](const std::string& curve) {
    return decode_gain_map_jpeg(
        file_of(with_segment(jpeg_of(even(16, 16, {150, 150, 150})), profile_with_curve(curve)),
                gains),
        "grey");
  };
  const double x = 150 / 255.;
  std::string table = "curv" + be32(0) + be32(3);  // x squared, roughly
  for (const int v : {0, 16384, 65535}) table += {static_cast<char>(v >> 8), static_cast<char>(v)};
  const std::string srgb = "para" + be32(0) + be32(3 << 16) + fixed16(2.4) + fixed16(1 / 1.055) +
                           fixed16(.055 / 1.055) + fixed16(1 / 12.92) + fixed16(.04045);
  const std::vector<std::pair<std::string, double>> curves = {
      {"curv" + be32(0) + be32(0), x},
      {"curv" + be32(0) + be32(1) + std::string("\x01\xcd", 2), std::pow(x, 461 / 256.)},
      {table, .25 + .75 * (2 * x - 1)},
      {"para" + be32(0) + be32(0) + fixed16(2.2), std::pow(x, 2.2)},
      {srgb, double{linear(150)}}};
  for (const auto& [curve, light] : curves) {
    const auto found = lit(curve);
    ASSERT_TRUE(found) << found.error().detail;
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(found->pixels.at(8, 8)[c] / (2 * light), 1, .01);
  }
  for (const std::string& bad : {std::string("mft2") + be32(0) + be32(0),
                                 "curv" + be32(0) + be32(1000), "para" + be32(0) + be32(9 << 16)}) {
    const auto found = lit(bad);  // taken for sRGB, which is said
    ASSERT_TRUE(found);
    EXPECT_NEAR(found->pixels.at(8, 8).g / (2 * double{linear(150)}), 1, .01);
  }
}

TEST(GainMapJpeg, WhatIsNoGainMapIsRefusedByItsReason) {
  const Bytes plain = jpeg_of(even(16, 16, {188, 188, 188}));
  const auto none = decode_gain_map_jpeg(plain, "plain.jpg");
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().where, "plain.jpg");
  EXPECT_NE(none.error().detail.find("without a gain map"), std::string::npos);
  const auto told = [&](const std::string& attributes) {
    return decode_gain_map_jpeg(
        file_of(plain, with_segment(plain, segment(0xe1, xmp("<rdf:Description " + attributes)))),
        "file");
  };
  EXPECT_TRUE(told("hdrgm:GainMapMax=\"1\""));
  EXPECT_TRUE(told("hdrgm:GainMapMax = '1'"));
  EXPECT_FALSE(told("hdrgm:GainMapMin=\"1\"")) << "the greatest gain has no default";
  EXPECT_FALSE(told("hdrgm:GainMapMax=\"nan\""));
  EXPECT_FALSE(told("hdrgm:GainMapMax=\"1e9\""));
  EXPECT_FALSE(told("hdrgm:GainMapMax=\"1\" hdrgm:Gamma=\"0\""));
  EXPECT_NE(told("hdrgm:GainMapMax=\"1\" hdrgm:BaseRenditionIsHDR=\"True\"")
                .error()
                .detail.find("brighter"),
            std::string::npos);
}

// Any finite radiance makes a file that can be read.
TEST(GainMapJpeg, ExtremeRadianceIsKeptAsFarAsItGoes) {
  Image<Rgb> wild(32, 16);
  for (int x = 0; x < 32; ++x)
    for (int y = 0; y < 16; ++y) wild.at(x, y) = Rgb{1, 1, 1} * (x < 16 ? 1e-38f : 1.f);
  wild.at(20, 8) = {3e38f, 1, 1};
  const auto made = encode_gain_map_jpeg(wild, base_of(wild));
  ASSERT_TRUE(made);
  const auto got = decode_gain_map_jpeg(*made, "wild");
  ASSERT_TRUE(got) << got.error().detail;
  EXPECT_EQ(got->non_finite, 0u);
  EXPECT_GT(got->pixels.at(20, 8).r, 1e12f);
  EXPECT_NEAR(got->pixels.at(28, 3).g, 1, .2);
}

TEST(GainMapJpeg, DamagedFilesAreRefusedWithoutHarm) {
  const Image<Rgb> truth = ramp();
  const Bytes made = *encode_gain_map_jpeg(truth, base_of(truth), 30);
  test::mutate_and_run(made, 400, 5, [](std::span<const unsigned char> bytes) {
    const auto got = decode_gain_map_jpeg(bytes, "fuzz");
    if (got) {
      EXPECT_FALSE(got->pixels.empty());
    }
  });
  for (std::size_t size = 0; size < made.size(); size += made.size() / 97)
    EXPECT_FALSE(decode_gain_map_jpeg(std::span(made).first(size), "cut")) << size;
}

}  // namespace
}  // namespace penumbra::codec
