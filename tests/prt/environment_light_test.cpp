#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/lights.h"

namespace penumbra::prt {
namespace {

using glm::dvec3;

Image<Rgb> map_of(int width, int height, auto radiance) {
  Image<Rgb> map(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      map.at(x, y) = radiance(latlong_direction(x + .5, y + .5, width, height));
  return map;
}

const std::vector<IrradiancePoint>& points_around() {
  static const std::vector<IrradiancePoint> points = [] {
    std::mt19937 rng(4);
    std::normal_distribution<double> gauss;
    std::vector<IrradiancePoint> made;
    for (int i = 0; i < 12; ++i)
      made.push_back({{0, 0, 0}, glm::normalize(dvec3(gauss(rng), gauss(rng), gauss(rng)))});
    return made;
  }();
  return points;
}

std::vector<Rgb> irradiance_under(const EnvironmentLight& light,
                                  const std::vector<IrradiancePoint>& points, int samples) {
  ReferenceWorld world;
  world.light = &light;
  const auto e = reference_irradiance(world, points, samples, 3);
  EXPECT_TRUE(e);
  return e ? *e : std::vector<Rgb>(points.size(), Rgb{NAN, NAN, NAN});
}

TEST(EnvironmentLight, RefusesMapsThatCannotLight) {
  Image<Rgb> map(8, 4, {1, 1, 1});
  map.at(3, 2).b = NAN;
  const auto nan = EnvironmentLight::from_map(map);
  ASSERT_FALSE(nan);
  EXPECT_EQ(nan.error().code, ErrorCode::kNonFinite);
  EXPECT_NE(nan.error().detail.find("3,2"), std::string::npos);
  map.at(3, 2).b = INFINITY;
  EXPECT_EQ(EnvironmentLight::from_map(map).error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(EnvironmentLight::from_map({}).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(EnvironmentLight::from_map(Image<Rgb>(65536, 1, {1, 1, 1})).error().code,
            ErrorCode::kInvalid);
  EXPECT_EQ(EnvironmentLight::from_map(Image<Rgb>(8, 4)).error().code, ErrorCode::kUndetermined);
}

TEST(EnvironmentLight, ShowsTheMapsPixelInEveryDirection) {
  std::mt19937 rng(1);
  Image<Rgb> map(16, 8);
  for (Rgb& p : map.pixels()) p = {float(rng() % 1000), float(rng() % 1000), 1};
  const auto light = EnvironmentLight::from_map(map);
  ASSERT_TRUE(light);
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 16; ++x)
      for (const double at : {.01, .5, .99})
        EXPECT_EQ(light->radiance(glm::vec3(latlong_direction(x + at, y + at, 16, 8))),
                  map.at(x, y));
}

TEST(EnvironmentLight, SamplesFallByTheirDensity) {
  std::mt19937 rng(2);
  std::lognormal_distribution<float> heavy(0, 2);
  Image<Rgb> map(16, 8);
  for (Rgb& p : map.pixels()) p = {heavy(rng), heavy(rng), heavy(rng)};
  map.at(5, 3) = {};  // black: never chosen
  const auto light = EnvironmentLight::from_map(map);
  ASSERT_TRUE(light);
  constexpr int kCount = 400'000;
  std::uniform_real_distribution<float> uniform(0, .9999999f);
  Image<float> counts(16, 8);
  for (int i = 0; i < kCount; ++i) {
    const float u1 = uniform(rng), u2 = uniform(rng);
    const auto s = light->sample(u1, u2);
    ASSERT_NEAR(glm::length(s.direction), 1, 1e-5);
    ASSERT_GT(s.density, 0);
    const glm::dvec2 p = latlong_pixel(dvec3(s.direction), 16, 8);
    counts.at(std::min(int(p.x), 15), std::min(int(p.y), 7)) += 1;
  }
  double whole = 0, square = 0;
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 16; ++x) {
      const double fraction = light->density(glm::vec3(latlong_direction(x + .5, y + .5, 16, 8))) *
                              latlong_solid_angle(y, 16, 8);
      whole += fraction;
      const double expected = kCount * fraction, off = counts.at(x, y) - expected;
      if (fraction > 0) square += off * off / expected;
      EXPECT_LE(std::abs(off), 5 * std::sqrt(expected) + 3) << x << ' ' << y;
    }
  EXPECT_NEAR(whole, 1, 1e-5) << "a density integrates to one";
  EXPECT_LT(square, 126 + 4 * std::sqrt(2 * 126.))
      << "chi square of 127 pixels, four standard deviations";
}

TEST(EnvironmentLight, SamplesCarryTheirOwnRadianceAndDensity) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<float> uniform(.1f, 5);
  Image<Rgb> map(32, 16);
  for (Rgb& p : map.pixels()) p = {uniform(rng), uniform(rng), uniform(rng)};
  const auto light = EnvironmentLight::from_map(map);
  ASSERT_TRUE(light);
  int elsewhere = 0;
  for (int i = 0; i < 10'000; ++i) {
    const auto s = light->sample(std::uniform_real_distribution<float>(0, .9999f)(rng),
                                 std::uniform_real_distribution<float>(0, .9999f)(rng));
    // On a pixel's rim the rounded direction may fall on the neighbour.
    if (light->radiance(s.direction) != s.radiance)
      ++elsewhere;
    else
      EXPECT_FLOAT_EQ(light->density(s.direction), s.density);
  }
  EXPECT_LT(elsewhere, 20);
}

TEST(EnvironmentLight, MapAndSphericalHarmonicsOfTheSameLightAgree) {
  const RadianceSh sh = test::sloped_light(1, {.4, -.5, .3}, 2);
  const auto smooth = EnvironmentLight::from_sh(sh);
  const auto map = EnvironmentLight::from_map(
      map_of(256, 128, [&](const dvec3& d) { return lighting::evaluate(sh, d); }));
  ASSERT_TRUE(map);
  EXPECT_TRUE(map->has_sampler());
  EXPECT_TRUE(smooth.has_sampler());
  const auto& points = points_around();
  const auto a = irradiance_under(smooth, points, 16384), b = irradiance_under(*map, points, 16384);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double exact = lighting::evaluate(lighting::irradiance(sh), points[i].normal).g;
    EXPECT_NEAR(a[i].g, exact, .005 * exact);
    EXPECT_NEAR(b[i].g, exact, .01 * exact);
    EXPECT_NEAR(b[i].g, a[i].g, .01 * exact);
  }
}

TEST(EnvironmentLight, SmallBrightSunGivesItsIrradiance) {
  constexpr int kWidth = 256, kHeight = 128;
  for (const auto& [x, y] : {std::pair{40, 30}, {128, 0}, {255, 64}, {7, 100}}) {
    Image<Rgb> map(kWidth, kHeight, {.1f, .1f, .2f});
    map.at(x, y) = {1e5f, 1e5f, 1e5f};
    const auto light = EnvironmentLight::from_map(map);
    ASSERT_TRUE(light);
    const dvec3 sun = latlong_direction(x + .5, y + .5, kWidth, kHeight);
    const double angle = latlong_solid_angle(y, kWidth, kHeight);
    const auto e = irradiance_under(*light, points_around(), 4096);
    for (std::size_t i = 0; i < e.size(); ++i) {
      const double towards = glm::dot(points_around()[i].normal, sun);
      // Within a pixel's width of the horizon, on either side, the sun is cut.
      if (std::abs(towards) < .03) continue;
      const double cosine = std::max(0., towards);
      const double sky = .1 * kPi, exact = sky + (1e5 - .1) * angle * cosine;
      EXPECT_NEAR(e[i].r, exact, .01 * exact) << "sun " << x << ',' << y << " cosine " << cosine;
    }
  }
}

TEST(EnvironmentLight, SunBehindASphereLeavesTheSky) {
  Image<Rgb> map(256, 128, {1, 1, 1});
  map.at(128, 20) = {1e5f, 1e5f, 1e5f};
  const auto light = EnvironmentLight::from_map(map);
  ASSERT_TRUE(light);
  const dvec3 sun = latlong_direction(128.5, 20.5, 256, 128);
  ReferenceWorld world;
  world.light = &*light;
  world.mesh = make_sphere(glm::vec3(5. * sun), 1, 4, {0, 0, 0});
  const std::vector<IrradiancePoint> points{{{0, 0, 0}, {0, 1, 0}}, {{3, 0, 0}, {0, 1, 0}}};
  const auto e = reference_irradiance(world, points, 65536, 1);
  ASSERT_TRUE(e);
  // The sphere hides pi (1/5)^2 of the cosine-weighted sky, tilted by the sun's height.
  EXPECT_NEAR((*e)[0].r, kPi * (1 - sun.y / 25), .01 * kPi) << "in the shadow";
  EXPECT_NEAR((*e)[1].r, 1e5 * latlong_solid_angle(20, 256, 128) * sun.y + kPi, .01 * (*e)[1].r);
}

}  // namespace
}  // namespace penumbra::prt
