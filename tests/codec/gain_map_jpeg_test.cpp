#include "codec/gain_map_jpeg.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <span>
#include <string>
#include <vector>

#include "codec/codec.h"

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

// As a viewer does: the index tells the second picture, its metadata the gains.
TEST(GainMapJpeg, AViewerGetsTheRadianceBack) {
  const Image<Rgb> truth = ramp();
  const auto made = encode_gain_map_jpeg(truth, 1, 95);
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
               offset = number_after(second, "hdrgm:OffsetSDR");
  EXPECT_EQ(number_after(second, "hdrgm:HDRCapacityMax"), most);
  double worst = 0;
  for (int y = 4; y < 64; ++y)
    for (int x = 0; x < 256; ++x) {
      if (y > 27 && y < 36) continue;  // blocks that hold both hues
      const double gain = std::exp2(most * map.at(x, y).g / 255.);
      const double red = (linear(shown.at(x, y).r) + offset) * gain - offset;
      worst = std::max(worst, std::abs(red - truth.at(x, y).r) / (truth.at(x, y).r + .05));
    }
  EXPECT_LT(worst, .1) << "8 bits over " << most << " stops";
  // The base keeps hues, where clipping each channel by itself would turn orange to white.
  const Rgb8 bright = shown.at(250, 50);
  EXPECT_NEAR(linear(bright.g) / linear(bright.r), .5, .05);
  EXPECT_NEAR(linear(bright.b) / linear(bright.r), .25, .05);
}

TEST(GainMapJpeg, ADarkPictureHasNoGainAndAnEmptyOneIsRefused) {
  Image<Rgb> dark(16, 16);
  std::ranges::fill(dark.pixels(), Rgb{.1f, .1f, .1f});
  EXPECT_TRUE(encode_gain_map_jpeg(dark, 1));
  EXPECT_EQ(encode_gain_map_jpeg({}, 1).error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::codec
