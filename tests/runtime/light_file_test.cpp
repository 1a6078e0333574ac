// Environment files that show a part of the sphere: what is not there is unseen, not black.
#include "runtime/pipeline/light_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "capture/capture.h"
#include "codec/codec.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

// What a fisheye of 180 degrees that looks ahead shows of a sky over a grey floor.
Image<float> ahead(const Image<Rgb>& map) {
  Image<float> seen(map.width(), map.height());
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      seen.at(x, y) =
          latlong_direction(x + .5, y + .5, map.width(), map.height()).z < 0 ? 1.f : 0.f;
  return seen;
}

TEST(LightFile, WhatNoCameraSawIsContinuedAndNotBlack) {
  const test::TempFolder folder;
  const Image<Rgb> whole = capture::make_sky_environment(128, 64, .8);
  Image<Rgb> half = whole;
  const Image<float> seen = ahead(whole);
  for (std::size_t i = 0; i < half.area(); ++i)
    if (seen.pixels()[i] == 0) half.pixels()[i] = {};
  const auto path = folder.path() / "half.exr", black = folder.path() / "black.exr";
  ASSERT_TRUE(codec::write_hdr(path, half, codec::Depth::kFloat, {}, seen));
  ASSERT_TRUE(codec::write_hdr(black, half, codec::Depth::kFloat));
  const auto light = read_light(path), naive = read_light(black);
  ASSERT_TRUE(light) << light.error().detail;
  ASSERT_TRUE(naive);
  EXPECT_NEAR(light->light.coverage, .5, .01);
  EXPECT_EQ(naive->light.coverage, 1) << "nothing tells that the rest was not seen";

  const auto up = [](const lighting::ShProjection& p) {
    return double(
        luminance(lighting::evaluate(lighting::irradiance(p.light), glm::dvec3(0, 1, 0))));
  };
  const auto truth = lighting::project_latlong(whole, kMaxBands);
  ASSERT_TRUE(truth);
  const double off = std::abs(up(light->light) / up(*truth) - 1),
               naive_off = std::abs(up(naive->light) / up(*truth) - 1);
  std::printf("half of a sky unseen: irradiance off by %.1f %%, as black by %.1f %%\n", 100 * off,
              100 * naive_off);
  EXPECT_GT(naive_off, .1);
  EXPECT_LT(off, .5 * naive_off);

  const auto map = whole_latlong(*light);
  ASSERT_TRUE(map);
  EXPECT_EQ(map->at(64, 10), half.at(64, 10)) << "what was seen stays";
  EXPECT_TRUE(std::ranges::all_of(map->pixels(), [](const Rgb& p) { return p.g >= 0; }));
  EXPECT_GT(map->at(0, 10).g, .1f * whole.at(0, 10).g) << "behind the camera";
}

}  // namespace
}  // namespace penumbra::runtime
