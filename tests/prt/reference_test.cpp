#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <random>
#include <vector>

#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/prt/bowl.h"
#include "tests/support/lights.h"

namespace penumbra::prt {
namespace {

using glm::dvec3;

constexpr Rgb kWhite{1, 1, 1}, kBlack{0, 0, 0};

Image<Rgb> map_of(int width, int height, auto radiance) {
  Image<Rgb> map(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      map.at(x, y) = radiance(latlong_direction(x + .5, y + .5, width, height));
  return map;
}

EnvironmentLight light_of(const Image<Rgb>& map) {
  auto light = EnvironmentLight::from_map(map);
  EXPECT_TRUE(light);
  return light ? *light : EnvironmentLight::from_sh(RadianceSh(1));
}

PinholeView view_of(int size, const Pose& world_from_camera) {
  return {size, size, {double(size), double(size)}, {size / 2., size / 2.}, world_from_camera};
}

Reference rendered(const ReferenceWorld& world, const PinholeView& view, int samples,
                   std::uint64_t seed = 1) {
  ReferenceOptions options;
  options.error = 0;  // as many samples as asked for
  options.max_samples = samples;
  options.seed = seed;
  auto picture = render_reference(world, view, options);
  EXPECT_TRUE(picture);
  return picture ? *picture : Reference{};
}

std::vector<Rgb> irradiance_at(const ReferenceWorld& world,
                               const std::vector<IrradiancePoint>& points, int samples) {
  auto result = reference_irradiance(world, points, samples, 7);
  EXPECT_TRUE(result);
  return result ? *result : std::vector<Rgb>(points.size(), Rgb{NAN, NAN, NAN});
}

ReferenceWorld world_of(Mesh mesh, const EnvironmentLight& light) {
  ReferenceWorld world;
  world.mesh = std::move(mesh);
  world.light = &light;
  return world;
}

Plane floor_of(Rgb albedo) {
  Plane plane;
  plane.albedo = albedo;
  return plane;
}

// ------------------------------------------------------------------------------------- camera

TEST(Reference, EmptyWorldShowsTheEnvironment) {
  const auto light = EnvironmentLight::from_sh(test::sloped_light(1, {.5, .25, -.2}));
  const Pose pose{glm::angleAxis(.7, glm::normalize(dvec3(1, 2, -.5))), {3, -2, 5}};
  const PinholeView view = view_of(24, pose);
  const Reference picture = rendered(world_of({}, light), view, 256);
  for (int y = 0; y < 24; ++y)
    for (int x = 0; x < 24; ++x) {
      // A camera looks along its -z with +y up; the top-left corner is (0, 0).
      const dvec3 d =
          pose.rotation * glm::normalize(dvec3((x + .5 - 12) / 24, -(y + .5 - 12) / 24, -1));
      EXPECT_NEAR(picture.radiance.at(x, y).g, 1 + glm::dot(d, dvec3(.5, .25, -.2)), .002)
          << x << ' ' << y;
    }
}

TEST(Reference, BackgroundReplacesTheEnvironmentForTheCameraOnly) {
  const auto light = EnvironmentLight::from_sh(test::constant_light({2, 2, 2}));
  ReferenceWorld world = world_of(make_sphere({0, 0, -3}, 1, 4, {.5f, .5f, .5f}), light);
  world.background = [](const glm::vec3&) { return Rgb{0, 7, 0}; };
  const Reference picture = rendered(world, view_of(31, {}), 1024);
  EXPECT_EQ(picture.radiance.at(0, 0), (Rgb{0, 7, 0}));
  EXPECT_NEAR(picture.radiance.at(15, 15).r, .5 * 2, .01);
  EXPECT_NEAR(picture.radiance.at(15, 15).g, .5 * 2, .01);
}

TEST(Reference, FurnaceMakesAConvexObjectGlowByItsAlbedo) {
  const Rgb radiance{2, 1, .5f}, albedo{.9f, .5f, .1f};
  const auto smooth = EnvironmentLight::from_sh(test::constant_light(radiance));
  const auto sampled = light_of(Image<Rgb>(32, 16, radiance));
  for (const EnvironmentLight* light : {&smooth, &sampled}) {
    const ReferenceWorld world = world_of(make_sphere({0, 0, -2}, 1.9f, 5, albedo), *light);
    const Reference picture = rendered(world, view_of(16, {}), 1024);
    for (const Rgb& p : picture.radiance.pixels())
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(p[c], albedo[c] * radiance[c], .01 * radiance[c]) << light->has_sampler();
  }
}

TEST(Reference, SameSeedGivesTheSamePictureAndAnotherSeedAnother) {
  const auto light = EnvironmentLight::from_sh(test::random_light(3, 1));
  const ReferenceWorld world = world_of(make_knot(1, 60, 12, {.5f, .6f, .7f}), light);
  const PinholeView view = view_of(16, {{1, 0, 0, 0}, {0, .5, 1.5}});
  const Reference a = rendered(world, view, 16, 5), b = rendered(world, view, 16, 5),
                  c = rendered(world, view, 16, 6);
  EXPECT_EQ(a.radiance, b.radiance);
  EXPECT_NE(a.radiance, c.radiance);
}

// ------------------------------------------------------------------------------------- error

// What the two halves of several pictures have to do with a converged one.
struct Halves {
  double product = 0, square_a = 0, square_b = 0;  // of their errors
  double square = 0, mean = 0;                     // of the picture's error; of the truth
  double reported_square = 0;

  void add(const Reference& picture, const Image<Rgb>& truth) {
    for (std::size_t i = 0; i < truth.area(); ++i) {
      const double t = luminance(truth.pixels()[i]);
      const double a = luminance(picture.half_a.pixels()[i]) - t;
      const double b = luminance(picture.half_b.pixels()[i]) - t;
      product += a * b, square_a += a * a, square_b += b * b;
      square += (a + b) * (a + b) / 4;
      mean += t / static_cast<double>(truth.area());
    }
    reported_square += picture.error * picture.error;
  }
};

TEST(Reference, HalvesAreIndependentAndTheErrorShrinksAsItShould) {
  const auto light = light_of(map_of(64, 32, [](const dvec3& d) {
    const auto v = static_cast<float>(1 + 4 * std::pow(std::max(0., d.x), 8.));
    return Rgb{v, v, v};
  }));
  ReferenceWorld world = world_of(make_knot(1, 60, 12, {.7f, .7f, .7f}), light);
  world.planes = {floor_of({.5f, .5f, .5f})};
  // From above, so that every pixel has noise.
  const PinholeView view = view_of(24, {glm::angleAxis(-kPi / 2, dvec3(1, 0, 0)), {0, 2, 0}});
  const Image<Rgb> truth = rendered(world, view, 8192, 99).radiance;
  constexpr int kSeeds = 6;
  double last = 10;
  for (const int samples : {16, 64, 256}) {
    Halves halves;
    for (std::uint64_t seed = 1; seed <= kSeeds; ++seed) {
      const Reference picture = rendered(world, view, samples, seed);
      ASSERT_EQ(picture.samples, samples);
      halves.add(picture, truth);
    }
    const double mean = halves.mean / kSeeds, reported = std::sqrt(halves.reported_square / kSeeds);
    const double error = std::sqrt(halves.square / (kSeeds * double(truth.area()))) / mean;
    // Neighbouring pixels share their edges: the correlation of one picture scatters by about .08.
    EXPECT_LT(std::abs(halves.product) / std::sqrt(halves.square_a * halves.square_b), .12)
        << samples;
    EXPECT_NEAR(reported / error, 1, .15) << samples;
    // Four times the samples halve the error, or better where they are better than random.
    EXPECT_LT(reported, .55 * last) << samples;
    last = reported;
  }
}

TEST(Reference, StopsAtTheErrorAskedFor) {
  const auto light = EnvironmentLight::from_sh(test::random_light(3, 2));
  ReferenceWorld world = world_of(make_sphere({0, 1, 0}, 1, 3, kWhite), light);
  world.planes = {floor_of({.5f, .5f, .5f})};
  const PinholeView view = view_of(16, {glm::angleAxis(-.3, dvec3(1, 0, 0)), {0, 2, 4}});
  ReferenceOptions options;
  options.error = .02;
  const auto picture = render_reference(world, view, options);
  ASSERT_TRUE(picture);
  EXPECT_LT(picture->error, .02);
  EXPECT_LT(picture->samples, options.max_samples);
  for (std::size_t i = 0; i < picture->radiance.area(); ++i)
    EXPECT_NEAR(picture->radiance.pixels()[i].r,
                (picture->half_a.pixels()[i].r + picture->half_b.pixels()[i].r) / 2, 1e-5);
}

TEST(Reference, RefusesImpossibleViews) {
  const auto light = EnvironmentLight::from_sh(RadianceSh(1));
  const ReferenceWorld world = world_of({}, light);
  for (const PinholeView& view :
       {PinholeView{0, 4, {4, 4}, {2, 2}, {}}, PinholeView{4, -1, {4, 4}, {2, 2}, {}},
        PinholeView{4, 4, {0, 4}, {2, 2}, {}}, PinholeView{4, 4, {4, -4}, {2, 2}, {}},
        PinholeView{4, 4, {NAN, 4}, {2, 2}, {}}, PinholeView{4, 4, {4, 4}, {2, NAN}, {}}}) {
    const auto picture = render_reference(world, view, {});
    EXPECT_FALSE(picture) << view.focal_px.x << ' ' << view.principal_px.y;
    EXPECT_TRUE(picture || picture.error().code == ErrorCode::kInvalid);
  }
}

TEST(Reference, TooFewSamplesNeverGiveNan) {
  const auto light = EnvironmentLight::from_sh(test::constant_light(kWhite));
  for (const int samples : {-1, 0, 1, 2, 3}) {
    ReferenceOptions options;
    options.max_samples = samples;
    const auto picture = render_reference(world_of({}, light), view_of(2, {}), options);
    if (!picture) continue;  // an error is as good
    for (const Rgb& p : picture->radiance.pixels()) EXPECT_TRUE(is_finite(p)) << samples;
  }
}

// ------------------------------------------------------------------------------------- irradiance

TEST(ReferenceIrradiance, SphereTakesItsClosedFormFromTheFloor) {
  const auto light = EnvironmentLight::from_sh(test::constant_light(kWhite));
  for (const double height : {1., 2.}) {
    ReferenceWorld world = world_of(make_sphere({0, float(height), 0}, 1, 5, kBlack), light);
    world.planes = {floor_of({.5f, .5f, .5f})};
    std::vector<IrradiancePoint> points;
    for (const double r : {.3, .8, 1.5, 2.5, 4.})
      points.push_back({{r * .6, 0, r * .8}, {0, 1, 0}});
    const auto e = irradiance_at(world, points, 16384);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const double d = glm::distance(points[i].position, dvec3(0, height, 0));
      EXPECT_NEAR(e[i].r / kPi, 1 - height / (d * d * d), .005) << height << ' ' << d;
    }
  }
}

TEST(ReferenceIrradiance, FloorAddsWhatItReflects) {
  // Over an infinite floor of albedo rho a surface with normal n sees (1 + n.y)/2 of sky and the
  // rest of floor. The points float alone, so nothing shades the floor.
  constexpr float kRho = .6f;
  const auto light = EnvironmentLight::from_sh(test::constant_light(kWhite));
  ReferenceWorld world = world_of({}, light);
  world.planes = {floor_of({kRho, kRho, kRho})};
  std::vector<IrradiancePoint> points;
  for (const double y : {-1., -.5, 0., .5, 1.})
    points.push_back({{0, 2, 0}, {std::sqrt(1 - y * y), y, 0}});
  const auto e = irradiance_at(world, points, 16384);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double sky = (1 + points[i].normal.y) / 2;
    EXPECT_NEAR(e[i].g / kPi, sky + (1 - sky) * kRho, .004) << points[i].normal.y;
  }
}

// A wall meets a black floor: its lowest points look up into the sky with one half and see nothing
// of what lies below the floor.
TEST(ReferenceIrradiance, WhatStandsOnTheFloorSeesNothingBelowIt) {
  const auto light = light_of(map_of(64, 32, [](const dvec3& d) {
    return d.y > 0 ? Rgb{1, 1, 1} : Rgb{100, 100, 100};
  }));
  ReferenceWorld world = world_of({}, light);
  world.planes.push_back({{0, 0, 0}, {0, 1, 0}, kBlack, {}});
  for (const double height : {-1e-7, 0., 1e-7, 1e-3}) {
    const auto e = irradiance_at(world, {{{0, height, 0}, {0, 0, 1}}}, 4096);
    EXPECT_NEAR(e[0].g, kPi / 2, .02 * kPi) << height;
  }
}

TEST(ReferenceIrradiance, TextureScalesTheFloorAndItsBackIsBlack) {
  const auto light = EnvironmentLight::from_sh(test::constant_light(kWhite));
  ReferenceWorld world = world_of({}, light);
  world.planes = {floor_of({.8f, .8f, .8f})};
  world.planes[0].texture = [](const dvec3& p) { return p.x < 0 ? Rgb{1, .5f, 0} : Rgb{0, 0, 0}; };
  const auto e = irradiance_at(world, {{{0, 1, 0}, {0, -1, 0}}, {{0, -1, 0}, {0, 1, 0}}}, 16384);
  EXPECT_NEAR(e[0].r / kPi, .8 / 2, .005);
  EXPECT_NEAR(e[0].g / kPi, .4 / 2, .005);
  EXPECT_EQ(e[0].b, 0);
  EXPECT_EQ(e[1], kBlack);
}

TEST(ReferenceIrradiance, BowlGlowsByTheClosedForm) {
  constexpr float kRho = .8f;
  const test::Bowl bowl = test::make_bowl(.4f, kRho);
  const auto light = EnvironmentLight::from_sh(test::constant_light(kWhite));
  std::vector<IrradiancePoint> points;
  for (std::size_t i = 0; i < bowl.mesh.positions.size(); i += 97)
    points.push_back({dvec3(bowl.mesh.positions[i]), dvec3(bowl.mesh.normals[i])});
  const double f = bowl.fraction, expected = (1 - f) / (1 - kRho * f);
  double mean = 0;
  for (const Rgb& e : irradiance_at(world_of(bowl.mesh, light), points, 8192)) {
    EXPECT_NEAR(e.r / kPi, expected, .02 * expected);
    mean += e.r / kPi / static_cast<double>(points.size());
  }
  EXPECT_NEAR(mean, expected, .005 * expected);
}

TEST(ReferenceIrradiance, AgreesWithTheBakeOnAnyShape) {
  const Mesh knot = make_knot(1, 120, 24, {.8f, .8f, .8f});
  const RadianceSh sh = test::sloped_light(1, {.4, .5, -.3}, 3);
  BakeOptions options;
  options.bands = 3;
  options.rays = 1024;
  options.bounces = 12;
  options.receiver = Receiver{fit_ground_grid(knot, 0, 64), {.5f, .5f, .5f}};
  const auto object = bake(knot, options);
  ASSERT_TRUE(object);
  std::vector<float> relit(3 * object->transfer.stride);
  relight(object->transfer, sh, relit);

  const auto light = EnvironmentLight::from_sh(sh);
  ReferenceWorld world = world_of(knot, light);
  world.planes = {floor_of({.5f, .5f, .5f})};
  std::vector<IrradiancePoint> points;
  for (std::size_t i = 0; i < knot.positions.size(); i += 59)
    points.push_back({dvec3(knot.positions[i]), dvec3(knot.normals[i])});
  const auto e = irradiance_at(world, points, 8192);
  double square = 0, bias = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double difference = relit[59 * i] - e[i].r / kPi;
    square += difference * difference / static_cast<double>(points.size());
    bias += difference / static_cast<double>(points.size());
  }
  EXPECT_LT(std::sqrt(square), .01) << "of a sky whose mean radiance is 1";
  EXPECT_LT(std::abs(bias), .003);
}

}  // namespace
}  // namespace penumbra::prt
