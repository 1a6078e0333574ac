#include "tools/chart/peers/rgbe_video.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "codec/codec.h"

namespace penumbra::tools {

using namespace codec;
namespace {

std::vector<Image<float>> moving_waves(int frames, int width = 40, int height = 27) {
  std::vector<Image<float>> maps;
  for (int f = 0; f < frames; ++f) {
    Image<float>& map = maps.emplace_back(width, height);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x)
        map.at(x, y) = static_cast<float>(.3 * std::sin(.2 * (x - f)) * std::cos(.15 * y) +
                                          (x > 30 ? 40 : 0));  // a jump of exponents
  }
  return maps;
}

double relative_rms(const std::vector<Image<float>>& a, const std::vector<Image<float>>& b) {
  double wrong = 0, all = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    for (std::size_t p = 0; p < a[i].area(); ++p) {
      wrong += std::pow(a[i].pixels()[p] - b[i].pixels()[p], 2);
      all += std::pow(a[i].pixels()[p], 2);
    }
  return std::sqrt(wrong / all);
}

TEST(RgbeVideo, BetterQualityIsLargerAndNearer) {
  const auto maps = moving_waves(12);
  double before = 1;
  std::size_t size = 0;
  for (const int quality : {5, 40, 90, 100}) {
    const auto bytes = encode_rgbe_video(maps, quality, 5);
    ASSERT_TRUE(bytes);
    const auto back = decode_rgbe_video(*bytes, "test");
    ASSERT_TRUE(back) << back.error().detail;
    ASSERT_EQ(back->size(), maps.size());
    const double error = relative_rms(maps, *back);
    EXPECT_LT(error, before) << quality;
    EXPECT_GT(bytes->size(), size);
    before = error;
    size = bytes->size();
  }
  EXPECT_LT(before, .005);  // half a step of eight bits
}

TEST(RgbeVideo, SignsAndZerosAreKept) {
  std::vector<Image<float>> maps(1, Image<float>(16, 16));
  for (int i = 0; i < 16; ++i) maps[0].at(i, 3) = i % 3 == 0 ? 0 : (i % 2 ? -.25f : .25f);
  const auto back = decode_rgbe_video(*encode_rgbe_video(maps, 95), "test");
  ASSERT_TRUE(back);
  for (int i = 0; i < 16; ++i) {
    const float was = maps[0].at(i, 3), is = (*back)[0].at(i, 3);
    EXPECT_EQ(was == 0, is == 0) << i;
    EXPECT_EQ(was < 0, is < 0) << i;
  }
}

TEST(RgbeVideo, BadInputIsRefusedAndDamageEndsNothing) {
  EXPECT_FALSE(encode_rgbe_video({}, 50));
  auto maps = moving_waves(3);
  EXPECT_FALSE(encode_rgbe_video(maps, 0));
  const auto bytes = *encode_rgbe_video(maps, 60);
  maps[1].at(2, 2) = NAN;
  EXPECT_FALSE(encode_rgbe_video(maps, 50));
  for (std::size_t cut = 0; cut < bytes.size(); cut += 7) {
    const auto back = decode_rgbe_video(std::span(bytes).first(cut), "cut");
    EXPECT_TRUE(!back || back->size() == 3u);
  }
  std::mt19937 random(5);
  for (int i = 0; i < 100; ++i) {
    auto wrong = bytes;
    wrong[random() % wrong.size()] ^= static_cast<unsigned char>(1 + random() % 255);
    (void)decode_rgbe_video(wrong, "wrong");
  }
}

TEST(RangeCoder, NumbersComeBack) {
  std::mt19937 random(1);
  std::vector<int> values;
  for (int i = 0; i < 20000; ++i) {
    const int size = static_cast<int>(random() % 24);
    const int v = static_cast<int>(random() & ((1u << size) - 1));
    values.push_back(random() % 2 ? v : -v);
  }
  RangeEncoder out;
  NumberModel model;
  for (const int v : values) model.encode(out, v);
  const auto bytes = std::move(out).finish();
  RangeDecoder in(bytes);
  NumberModel again;
  for (const int v : values) ASSERT_EQ(again.decode(in), v);
}

TEST(RangeCoder, WhatIsAlwaysTheSameCostsNextToNothing) {
  RangeEncoder out;
  NumberModel model;
  for (int i = 0; i < 10000; ++i) model.encode(out, 0);
  EXPECT_LT(std::move(out).finish().size(), 120u);
}

}  // namespace
}  // namespace penumbra::tools
