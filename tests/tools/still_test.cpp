#include "tools/pictures/still.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/conventions.h"
#include "tests/support/worlds.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

const prt::PinholeView kView{
    96, 72, {90, 90}, {48, 36}, capture::look_at({.5, 1.2, 1.5}, {0, .15, 0})};

lighting::LightEstimate even_light() {
  lighting::LightEstimate light;
  light.valid = true;
  light.light = RadianceSh(2);
  light.light[0] = Rgb{1, 1, 1} * static_cast<float>(std::sqrt(4 * kPi));
  light.upper_hemisphere_light = light.light;
  light.mean_radiance = {1, 1, 1};
  return light;
}

// The mean of four passes of an untouched pixel is the pixel: fl(p + p + p)/4 + p/4 rounds back to
// p.
TEST(Still, PixelsThatNothingReachesAreTheSameToTheBit) {
  const auto scene = test::prepared({{test::twist({60, 0, 0})}, {test::grey_plane()}});
  ASSERT_TRUE(scene) << scene.error().detail;
  Still real;
  real.radiance = Image<Rgb>(kView.width, kView.height);
  float value = 1e-6f;
  for (Rgb& c : real.radiance.pixels()) {
    c = {value, 3.3f * value, 7.7f * value};
    value *= 1.003f;
  }
  const auto shown = render_composite({&*scene, nullptr, kView}, even_light(), real);
  if (!shown && shown.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << shown.error().detail;
  ASSERT_TRUE(shown);
  EXPECT_EQ(shown->radiance, real.radiance);
}

// A pixel at an object's edge shows the fraction that the object covers: over a black and a white
// backdrop the pictures differ by what is left of it. Sixteen samples know sixteenths of it alone.
TEST(Still, EdgesKnowFinerFractionsThanOnePassHas) {
  const auto scene = test::prepared({{test::twist({0, 0, 0})}, {}});
  ASSERT_TRUE(scene) << scene.error().detail;
  const auto shown = [&](float backdrop) {
    Still real;
    real.radiance = Image<Rgb>(kView.width, kView.height, {backdrop, backdrop, backdrop});
    return render_composite({&*scene, nullptr, kView}, even_light(), real);
  };
  const auto dark = shown(0), bright = shown(1);
  if (!dark && dark.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << dark.error().detail;
  ASSERT_TRUE(dark && bright);
  int edges = 0, finer = 0;
  for (std::size_t i = 0; i < dark->radiance.area(); ++i) {
    const float open = bright->radiance.pixels()[i].g - dark->radiance.pixels()[i].g;
    if (open < .01f || open > .99f) continue;
    ++edges;
    const float sixteenths = 16 * open;
    finer += std::abs(sixteenths - std::round(sixteenths)) > .1f;
  }
  EXPECT_GT(edges, 60);
  EXPECT_GT(finer, edges / 2);
}

TEST(Still, AMirrorSeesTheHighestLevelPlaneBelow) {
  const Image<Rgb> map(64, 32, {2, 2, 2});
  const auto at = [](double height, const glm::dvec3& normal, const Rgb& albedo) {
    return prt::Plane{{0, height, 0}, normal, albedo, {}};
  };
  const glm::dvec3 up(0, 1, 0);
  EXPECT_EQ(with_floor_below(map, {}), map);
  EXPECT_EQ(with_floor_below(map, {at(0, up, {})}), map) << "of unknown albedo";
  EXPECT_EQ(with_floor_below(map, {at(0, {0, 0, 1}, {.5f, .5f, .5f})}), map) << "a wall";
  const Image<Rgb> seen =
      with_floor_below(map, {at(0, up, {.1f, .1f, .1f}), at(.75, up, {.5f, .25f, .125f}),
                             at(.9, up, {}), at(2, {0, 0, 1}, {.9f, .9f, .9f})});
  for (int x = 0; x < 64; ++x) {
    EXPECT_EQ(seen.at(x, 15), (Rgb{2, 2, 2}));
    EXPECT_NEAR(seen.at(x, 16).r, 1, .01) << "half of even light";
    EXPECT_NEAR(seen.at(x, 31).b, .25, .01);
  }
}

}  // namespace
}  // namespace penumbra::tools
