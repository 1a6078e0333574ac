// What the light is published with: how far the irradiance of surfaces may be off.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "core/conventions.h"
#include "lighting/lighting.h"
#include "lighting/sh/map_average.h"
#include "tests/support/environment_maps.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;
using lighting::LightEstimate;
using lighting::LightEstimator;
using lighting::LightUncertainty;

constexpr int kSmallWidth = 256, kSmallHeight = 128;

// Black where the angle to `axis` is below this, and not seen.
Environment hidden(const Image<Rgb>& map, const dvec3& axis, double radius_rad) {
  Environment e;
  e.radiance = map;
  e.confidence = Image<float>(kSmallWidth, kSmallHeight, 1);
  for (int y = 0; y < kSmallHeight; ++y)
    for (int x = 0; x < kSmallWidth; ++x)
      if (dot(latlong_direction(x + .5, y + .5, kSmallWidth, kSmallHeight), axis) >
          std::cos(radius_rad))
        e.radiance.at(x, y) = {}, e.confidence.at(x, y) = 0;
  return e;
}

// RMS over all normals of what the irradiances differ by, over the mean irradiance of the second.
double irradiance_error(const LightEstimate& a, const LightEstimate& b) {
  const RadianceSh x = lighting::whole_light(a), y = lighting::whole_light(b);
  double square = 0;
  for (int l = 0; l < x.bands(); ++l)
    for (int n = coefficient_count(l); n < coefficient_count(l + 1); ++n)
      square += std::pow(
          lighting::cosine_coefficient(l) * (double(luminance(x[n])) - double(luminance(y[n]))), 2);
  return std::sqrt(square / (4 * kPi)) / (kPi * double(luminance(b.mean_radiance)));
}

// Half of the sphere, or a cone of 60 degrees, hidden from six sides.
TEST(LightUncertaintyOfMaps, WhatNoCameraSeesIsAsUncertainAsItSays) {
  std::vector<std::string> names = {"room", "clear_sky"};
  if (test::shared_data("envmaps"))
    names.insert(names.end(),
                 {"adams_place_bridge", "immenstadter_horn", "kloofendal_48d_partly_cloudy_puresky",
                  "potsdamer_platz", "rustig_koppie_puresky", "st_fagans_interior",
                  "studio_small_03", "venice_sunset"});
  double square = 0;
  int cases = 0;
  for (const std::string& name : names) {
    const auto large = test::environment_map(name);
    if (!large) {
      std::printf("%s: %s\n", name.c_str(), large.error().where.c_str());
      continue;
    }
    Image<Rgb> map;
    lighting::average_blocks(*large, 4, map);
    ASSERT_EQ(map.width(), kSmallWidth);
    const auto truth = lighting::estimate_map(map, {});
    ASSERT_TRUE(truth);
    EXPECT_EQ(truth->uncertainty.total, 0);
    for (const double radius_deg : {90., 60.})
      for (const dvec3& axis : {dvec3(1, 0, 0), dvec3(-1, 0, 0), dvec3(0, 1, 0), dvec3(0, -1, 0),
                                dvec3(0, 0, 1), dvec3(0, 0, -1)}) {
        const auto seen = LightEstimator(lighting::EstimateOptions{})
                              .estimate(hidden(map, axis, radius_deg * kPi / 180));
        ASSERT_TRUE(seen);
        ASSERT_TRUE(seen->uncertainty.total);
        EXPECT_NEAR(*seen->uncertainty.total,
                    LightUncertainty::kContinued * (1 - std::cos(radius_deg * kPi / 180)) / 2,
                    .005);
        square += std::pow(irradiance_error(*seen, *truth) / *seen->uncertainty.total, 2);
        ++cases;
      }
  }
  const double ratio = std::sqrt(square / cases);
  std::printf("error over what is said, RMS of %d holes: %.2f\n", cases, ratio);
  EXPECT_GT(ratio, .6);
  EXPECT_LT(ratio, 1.3);
}

TEST(LightUncertainty, IsUnknownOverALowerBound) {
  Environment e;
  e.radiance = Image<Rgb>(kSmallWidth, kSmallHeight, {1, 1, 1});
  for (const int x : {100, 101}) {
    e.radiance.at(x, 30) = {5000, 5000, 5000};
    e.clipped.push_back(30u * kSmallWidth + static_cast<std::uint32_t>(x));
  }
  const auto estimate = LightEstimator(lighting::EstimateOptions{}).estimate(e);
  ASSERT_TRUE(estimate);
  EXPECT_FALSE(estimate->uncertainty.total);
  EXPECT_EQ(estimate->uncertainty.unseen, 0);
}

}  // namespace
}  // namespace penumbra::runtime
