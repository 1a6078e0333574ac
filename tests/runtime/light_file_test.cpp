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
  const auto filled = lighting::project_latlong(*map, kMaxBands);
  ASSERT_TRUE(filled);
  EXPECT_NEAR(up(*filled) / up(*truth), 1, .06) << "the sun counts once";
  EXPECT_TRUE(std::ranges::all_of(map->pixels(), [](const Rgb& p) { return p.g >= 0; }));
  EXPECT_GT(map->at(0, 10).g, .1f * whole.at(0, 10).g) << "behind the camera";
}

// A small bright view of an even room is no light of its own.
TEST(LightFile, AConstantRoomIsConstantThroughAnyWindow) {
  const test::TempFolder folder;
  for (const double half_angle : {.45, .65, .8, 1.2, 1.8}) {
    Image<Rgb> map(128, 64);
    Image<float> seen(128, 64);
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 128; ++x)
        if (-latlong_direction(x + .5, y + .5, 128, 64).z > std::cos(half_angle))
          map.at(x, y) = {1, 2, 3}, seen.at(x, y) = 1;
    const auto path = folder.path() / "window.exr";
    ASSERT_TRUE(codec::write_hdr(path, map, codec::Depth::kFloat, {}, seen));
    const auto light = read_light(path);
    ASSERT_TRUE(light) << light.error().detail;
    EXPECT_NEAR(light->light.coverage, (1 - std::cos(half_angle)) / 2, .01);
    EXPECT_NEAR(light->light.light[0].g, 2 * std::sqrt(4 * kPi), .01) << half_angle;
    lighting::LightEstimator estimator({});
    const auto estimate = estimator.estimate({map, seen, {}, 0, 0});
    ASSERT_TRUE(estimate);
    EXPECT_TRUE(estimate->lights.empty()) << half_angle;
    EXPECT_NEAR(estimate->mean_radiance.g, 2, .01) << half_angle;
  }
}

}  // namespace
}  // namespace penumbra::runtime
