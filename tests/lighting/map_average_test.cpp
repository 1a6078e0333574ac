// Blocks of pixels hold all light of a map.
#include "lighting/sh/map_average.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/conventions.h"

namespace penumbra::lighting {
namespace {

TEST(MapAverage, KeepsAllLightOfAMap) {
  Image<Rgb> map(512, 256);
  std::mt19937 rng(7);
  std::uniform_real_distribution<float> uniform(0, 2);
  for (Rgb& c : map.pixels()) c = {uniform(rng), uniform(rng), uniform(rng)};
  map.at(17, 3) = map.at(300, 250) = {1e5f, 2e5f, 3e5f};  // near the poles, where rows differ most
  Image<Rgb> blocks;
  ASSERT_TRUE(divides_into_blocks(map, 4));
  average_blocks(map, 4, blocks);
  ASSERT_EQ(blocks.width(), 128);
  ASSERT_EQ(blocks.height(), 64);
  const auto total = [](const Image<Rgb>& m) {
    double sum = 0;
    for (int y = 0; y < m.height(); ++y)
      for (int x = 0; x < m.width(); ++x)
        sum += latlong_solid_angle(y, m.width(), m.height()) * double(m.at(x, y).b);
    return sum;
  };
  EXPECT_NEAR(total(blocks), total(map), 1e-5 * total(map));
  // Naive: every fourth pixel.
  Image<Rgb> picked(128, 64);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 128; ++x) picked.at(x, y) = map.at(4 * x, 4 * y);
  EXPECT_GT(std::abs(total(picked) - total(map)), .1 * total(map));
}

TEST(MapAverage, SmallAndOddMapsAreReadAsTheyAre) {
  EXPECT_FALSE(divides_into_blocks(Image<Rgb>(256, 128), 4)) << "too few rows would be left";
  EXPECT_FALSE(divides_into_blocks(Image<Rgb>(1020, 510), 4));
  EXPECT_TRUE(divides_into_blocks(Image<Rgb>(1024, 512), 4));
}

}  // namespace
}  // namespace penumbra::lighting
