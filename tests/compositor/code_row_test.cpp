#include "compositor/pixels/code_row.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "compositor/pixels/sensor_effects.h"
#include "tests/support/scenes.h"

namespace penumbra::compositor {
namespace {

struct Row {
  std::vector<float> object, r, g, b;
  std::vector<Rgb8> pixels;
};

Row random_row(std::size_t count, std::mt19937& random) {
  std::uniform_real_distribution<float> unit(0, 1);
  std::uniform_int_distribution<int> code(0, 255);
  Row row;
  for (std::size_t i = 0; i < count; ++i) {
    const bool open = unit(random) < .4f, bare = unit(random) < .5f;
    for (auto* v : {&row.r, &row.g, &row.b}) v->push_back(open ? 1 : 1.2f * unit(random));
    const float coverage = bare ? 0 : unit(random);
    for (int c = 0; c < 3; ++c) row.object.push_back(coverage * 1.5f * unit(random));
    row.object.push_back(coverage);
    const auto byte = [&] { return static_cast<std::uint8_t>(code(random)); };
    row.pixels.push_back({byte(), byte(), byte()});
  }
  return row;
}

// One pixel at a time, as the formula says.
std::size_t plainly(const ResponseTable& curve, const Rgb& clipped, const Row& row,
                    bool with_object, std::vector<Rgb8>& pixels) {
  const auto decode = [&](int c, std::uint8_t code) {
    return decode_clipped(curve, c, code, clipped[c]);
  };
  std::size_t touched = 0;
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    const float none[4] = {};
    const float* const v = with_object ? &row.object[4 * i] : none;
    if (v[3] == 0 && row.r[i] == 1 && row.g[i] == 1 && row.b[i] == 1) continue;
    ++touched;
    const float behind = 1 - v[3];
    Rgb8& p = pixels[i];
    p.r = curve.encode8(0, v[0] + behind * row.r[i] * decode(0, p.r));
    p.g = curve.encode8(1, v[1] + behind * row.g[i] * decode(1, p.g));
    p.b = curve.encode8(2, v[2] + behind * row.b[i] * decode(2, p.b));
  }
  return touched;
}

TEST(CodeRow, EqualsTheFormulaPixelByPixelForEveryLength) {
  const ResponseTable curve = test::srgb_curve(8);
  std::mt19937 random(5);
  for (std::size_t count = 0; count < 200; count += count < 70 ? 1 : 13)
    for (const bool with_object : {false, true}) {
      Row row = random_row(count, random);
      for (std::size_t i = 0; i < count; i += 3) row.pixels[i].g = 255;
      const Rgb clipped = with_object ? Rgb{1, 1, 1} : Rgb{1, 2.5f, 1.2f};
      std::vector<Rgb8> expected = row.pixels, got = row.pixels;
      got.push_back({1, 2, 3});  // what follows the row
      const std::size_t touched = plainly(curve, clipped, row, with_object, expected);
      EXPECT_EQ(composite_codes(curve, clipped, with_object ? row.object.data() : nullptr,
                                row.r.data(), row.g.data(), row.b.data(), got.data(), count),
                touched);
      ASSERT_EQ(got.back(), (Rgb8{1, 2, 3}));
      got.pop_back();
      ASSERT_EQ(got, expected) << count;
    }
}

TEST(CodeRow, CodesNearTheLargestRiseToWhatItStandsFor) {
  for (const int bits : {8, 16}) {
    const ResponseTable curve = test::srgb_curve(bits);
    const unsigned last = curve.largest_code();
    EXPECT_FLOAT_EQ(decode_clipped(curve, 1, last, 2.5f), 2.5f);
    EXPECT_EQ(decode_clipped(curve, 1, last, .5f), curve.decode(1, last)) << "never less";
    float before = 0, step = 0;
    for (unsigned code = 0; code <= last; ++code) {
      const float now = decode_clipped(curve, 1, code, 2.5f);
      if (curve.decode(1, code) <= .95f) {
        ASSERT_EQ(now, curve.decode(1, code)) << code;
      }
      ASSERT_GE(now, before) << code;
      step = std::max(step, now - before), before = now;
    }
    EXPECT_LT(step, .35f) << "noise about full scale would make specks";
  }
}

TEST(CodeRow, NotANumberIsBlackAndInfinityWhite) {
  const ResponseTable curve = test::srgb_curve(8);
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN(),
                  kInf = std::numeric_limits<float>::infinity();
  std::vector<float> object(64, 0.f), ratio(16, .5f);
  object[0] = kNan, object[4] = kInf, object[8] = -kInf;
  for (const std::size_t i : {3, 7, 11}) object[i] = 1;
  std::vector<Rgb8> pixels(16, Rgb8{90, 90, 90});
  composite_codes(curve, {1, 1, 1}, object.data(), ratio.data(), ratio.data(), ratio.data(),
                  pixels.data(), 16);
  EXPECT_EQ(pixels[0].r, 0);
  EXPECT_EQ(pixels[1].r, 255);
  EXPECT_EQ(pixels[2].r, 0);
}

TEST(MarkTouched, FindsTheSameAsALook) {
  std::mt19937 rng(5);
  for (const std::size_t width : {1u, 7u, 16u, 33u, 100u}) {
    const std::size_t stride = padded_row(static_cast<int>(width)) + 2 * kSensorLanes;
    for (int round = 0; round < 40; ++round) {
      std::vector<float> planes(6 * stride, 0.f);
      // Dirt past the width, and zeros with a sign, are nothing.
      for (std::size_t p = 0; p < 6; ++p)
        for (std::size_t i = 0; i < stride; ++i)
          planes[p * stride + i] = i >= width ? 3.f : rng() % 3 == 0 ? -0.f : 0.f;
      const int marks = static_cast<int>(rng() % 4);
      std::vector<char> marked(width, 0);
      for (int k = 0; k < marks; ++k) {
        const std::size_t i = rng() % width;
        planes[rng() % 6 * stride + i] = k % 2 ? -1e-30f : .5f;
        marked[i] = 1;
      }
      std::vector<std::uint32_t> touched(stride, 7u);
      const auto [first, last] = mark_touched(planes.data(), stride, width, touched.data());
      for (std::size_t i = 0; i < width; ++i) EXPECT_EQ(touched[i] != 0, marked[i] != 0);
      const auto begin = std::ranges::find(marked, 1);
      const auto left = static_cast<std::size_t>(begin - marked.begin());
      if (begin == marked.end()) {
        EXPECT_EQ(first, last);
        continue;
      }
      std::size_t right = width;
      while (!marked[right - 1]) --right;
      EXPECT_EQ(first, left);
      EXPECT_EQ(last, right);
    }
  }
}

}  // namespace
}  // namespace penumbra::compositor
