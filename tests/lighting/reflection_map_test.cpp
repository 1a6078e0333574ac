// Reflection maps against closed forms and against the lobe's integral.
#include "lighting/reflections/reflection_map.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"
#include "core/environment.h"
#include "lighting/estimate.h"
#include "lighting/reflections/cube_map.h"
#include "lighting/reflections/ggx.h"

namespace penumbra::lighting {
namespace {

// A room with a window, a lamp and a dark floor.
Image<Rgb> make_room(int width, int height) {
  Image<Rgb> map(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const glm::dvec3 d = latlong_direction(x + .5, y + .5, width, height);
      Rgb c{.4f, .35f, .3f};
      if (d.y < -.3) c = {.1f, .08f, .06f};
      if (d.x > .6 && std::abs(d.y) < .4) c = {6, 7, 9};
      if (glm::dot(d, glm::normalize(glm::dvec3(-1, 2, 1))) > .995) c = {40, 30, 20};
      map.at(x, y) = c;
    }
  return map;
}

ReflectionMap filtered(const Image<Rgb>& map, const RoughnessRange& asked) {
  ReflectionMap out;
  ReflectionFilter(asked).filter(map, {}, RadianceSh(1), out);
  return out;
}

// The mean over the lobe seen along the normal, pixel by pixel of the map.
Rgb lobe_mean(const Image<Rgb>& map, const glm::vec3& n, float roughness) {
  const float alpha = roughness * roughness;
  glm::dvec3 sum(0);
  double weights = 0;
  for (int y = 0; y < map.height(); ++y) {
    const double area = latlong_solid_angle(y, map.width(), map.height());
    for (int x = 0; x < map.width(); ++x) {
      const glm::dvec3 l = latlong_direction(x + .5, y + .5, map.width(), map.height());
      const double along = glm::dot(l, glm::dvec3(n));
      if (along <= 0) continue;
      const float n_dot_m = static_cast<float>(std::sqrt(.5 * (1 + along)));
      // As the sum of Karis takes it: samples by D n.m/(4 v.m), each weighted by n.l.
      const double weight = area * along * ggx_density(alpha, n_dot_m);
      const Rgb& c = map.at(x, y);
      sum += weight * glm::dvec3(c.r, c.g, c.b);
      weights += weight;
    }
  }
  sum /= weights;
  return {static_cast<float>(sum.x), static_cast<float>(sum.y), static_cast<float>(sum.z)};
}

TEST(CubeMaps, APlaceAndItsDirectionAreOne) {
  for (int face = 0; face < 6; ++face)
    for (const float s : {.01f, .3f, .77f, .99f})
      for (const float t : {.02f, .5f, .98f}) {
        const CubePlace at = cube_place(cube_direction(face, s, t));
        EXPECT_EQ(at.face, face);
        EXPECT_NEAR(at.s, s, 1e-5);
        EXPECT_NEAR(at.t, t, 1e-5);
      }
}

TEST(Ggx, HalfVectorsFollowTheDensity) {
  // E[g] over samples is the integral of g D m.z.
  for (const float alpha : {.1f, .4f, 1.f}) {
    double sampled = 0, integral = 0;
    const auto half = ggx_half_vectors(alpha, 4096);
    for (const glm::vec3& m : half) sampled += m.z * m.z / static_cast<double>(half.size());
    constexpr int kSteps = 200'000;
    for (int i = 0; i < kSteps; ++i) {
      const double z = (i + .5) / kSteps;
      integral += 2 * kPi / kSteps * z * z * z * ggx_density(alpha, static_cast<float>(z));
    }
    EXPECT_NEAR(sampled, integral, 2e-3) << alpha;
  }
}

TEST(Ggx, AMirrorReflectsAllOfEvenLight) {
  for (const float cosine : {.1f, .5f, 1.f}) {
    const glm::vec2 e = reflected_of_even(cosine, .02f);
    EXPECT_NEAR(e.x + e.y, 1, 2e-3) << cosine;
    EXPECT_NEAR(e.y, std::pow(1 - cosine, 5.f), .01) << cosine;
  }
}

TEST(Ggx, ReflectsWhatItsIntegralSays) {
  // By quadrature over incoming directions instead of half vectors.
  for (const float roughness : {.4f, .7f, 1.f})
    for (const float cosine : {.3f, .8f}) {
      const float alpha = roughness * roughness;
      const glm::vec3 v(std::sqrt(1 - cosine * cosine), 0, cosine);
      double one = 0;
      constexpr int kSteps = 1200;
      for (int i = 0; i < kSteps; ++i)
        for (int j = 0; j < kSteps; ++j) {
          const float z = (static_cast<float>(i) + .5f) / kSteps,
                      phi = 2 * static_cast<float>(kPi) * (static_cast<float>(j) + .5f) / kSteps;
          const float r = std::sqrt(1 - z * z);
          const glm::vec3 l(r * std::cos(phi), r * std::sin(phi), z), m = glm::normalize(l + v);
          one += 2 * kPi / (double(kSteps) * kSteps) * ggx_density(alpha, m.z) *
                 ggx_visibility(alpha, z, cosine) * z;
        }
      const glm::vec2 e = reflected_of_even(cosine, roughness);
      EXPECT_NEAR(e.x + e.y, one, .01) << roughness << ' ' << cosine;
    }
}

TEST(ReflectionMaps, EvenLightStaysEvenAtEveryRoughness) {
  Image<Rgb> even(256, 128);
  for (Rgb& p : even.pixels()) p = {.5f, 1, 2};
  const ReflectionMap map = filtered(even, {.least = 0, .most = 1});
  for (const CubeMap& level : map.levels)
    for (const Image<Rgb>& face : level.faces)
      for (const Rgb& p : face.pixels()) {
        EXPECT_NEAR(p.r, .5, 1e-5);
        EXPECT_NEAR(p.b, 2, 1e-5);
      }
}

TEST(ReflectionMaps, AMirrorShowsTheMap) {
  const Image<Rgb> room = make_room(1024, 512);
  const ReflectionMap map = filtered(room, {.least = 0, .most = 0});
  double off = 0;
  int count = 0;
  for (int y = 8; y < 504; y += 7)
    for (int x = 3; x < 1024; x += 11, ++count) {
      const Rgb shown = sample(map.levels[0], latlong_direction(x + .5, y + .5, 1024, 512));
      off += std::abs(shown.g - room.at(x, y).g) > .05 * room.at(x, y).g ? 1 : 0;
    }
  EXPECT_LT(off / count, .02);  // but for the edges of the window and the lamp
}

TEST(ReflectionMaps, EachLevelIsTheMeanOverItsLobe) {
  const Image<Rgb> room = make_room(512, 256);
  const ReflectionMap map = filtered(room, {.least = 0, .most = 1});
  for (int level = 1; level < ReflectionMap::kLevels; ++level) {
    double squares = 0, mean = 0;
    int count = 0;
    for (int face = 0; face < 6; ++face)
      for (const float s : {.12f, .4f, .81f})
        for (const float t : {.2f, .6f, .9f}) {
          const CubeMap& cube = map.levels[static_cast<std::size_t>(level)];
          const int size = cube.size(), x = static_cast<int>(s * static_cast<float>(size)),
                    y = static_cast<int>(t * static_cast<float>(size));
          const glm::vec3 d =
              cube_direction(face, (static_cast<float>(x) + .5f) / static_cast<float>(size),
                             (static_cast<float>(y) + .5f) / static_cast<float>(size));
          const Rgb truth = lobe_mean(room, d, ReflectionMap::roughness_of(level));
          const double error = cube.faces[static_cast<std::size_t>(face)].at(x, y).g - truth.g;
          squares += error * error, mean += truth.g, ++count;
        }
    RecordProperty("relative_rms_" + std::to_string(level),
                   std::to_string(std::sqrt(squares / count) / (mean / count)));
    EXPECT_LT(std::sqrt(squares / count), .07 * mean / count) << level;
  }
}

TEST(ReflectionMaps, WhatNobodyAskedForIsNotMade) {
  const ReflectionMap map = filtered(make_room(256, 128), {.least = .6f, .most = .6f});
  EXPECT_TRUE(map.levels[2].empty());
  EXPECT_EQ(map.levels[3].size(), 32);
  EXPECT_EQ(map.levels[4].size(), 16);
  EXPECT_TRUE(map.levels[5].empty());
}

TEST(ReflectionMaps, WhatWasNotSeenShowsTheLightThere) {
  Image<Rgb> map(256, 128);
  Image<float> confidence(256, 128);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 256; ++x) map.at(x, y) = {1, 1, 1}, confidence.at(x, y) = 1;
  RadianceSh light(1);
  light[0] = Rgb{.5f, .5f, .5f} * static_cast<float>(std::sqrt(4 * kPi));
  ReflectionMap out;
  ReflectionFilter({.least = 0, .most = 0}).filter(map, confidence, light, out);
  EXPECT_NEAR(sample(out.levels[0], {0, 1, 0}).g, 1, 1e-5);
  EXPECT_NEAR(sample(out.levels[0], {0, -1, 0}).g, .5, 1e-5);
}

// A sun over stripes that are finer than a block of the map.
Environment sun_over_stripes() {
  Environment out;
  out.radiance = Image<Rgb>(1024, 512);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 1024; ++x) {
      const glm::dvec3 d = latlong_direction(x + .5, y + .5, 1024, 512);
      const bool sun = glm::dot(d, glm::normalize(glm::dvec3(1, 1, -1))) > std::cos(.01);
      const float stripe = x / 2 % 2 == 0 ? .5f : 1.5f;
      out.radiance.at(x, y) = sun ? Rgb{9000, 9000, 9000} : Rgb{stripe, stripe, stripe};
    }
  return out;
}

TEST(ReflectionMaps, LightThatIsReadInBlocksIsMirroredByPixels) {
  for (const int step : {1, kMapBlock}) {
    LightEstimator estimator({.bands = 3, .filter = false, .map_step = step});
    estimator.mirror({.least = 0, .most = 0});
    const auto light = estimator.estimate(sun_over_stripes());
    ASSERT_TRUE(light);
    ASSERT_TRUE(light->reflections);
    float dark = 10, bright = 0;
    for (int x = 500; x < 520; ++x) {
      const Rgb c = sample(light->reflections->levels[0],
                           glm::vec3(latlong_direction(x + .5, 256.5, 1024, 512)));
      dark = std::min(dark, c.g), bright = std::max(bright, c.g);
    }
    EXPECT_LT(dark, .8f) << step;
    EXPECT_GT(bright, 1.2f) << step;
  }
}

TEST(ReflectionMaps, WhatIsMirroredApartIsNotInThem) {
  for (const int step : {1, kMapBlock}) {
    LightEstimator estimator({.bands = 3, .filter = false, .map_step = step});
    estimator.mirror({.least = 0, .most = .5f});
    const auto light = estimator.estimate(sun_over_stripes());
    ASSERT_TRUE(light);
    ASSERT_EQ(lights_apart(light->lights).size(), 1U) << step;
    for (const CubeMap& level : light->reflections->levels)
      for (const Image<Rgb>& face : level.faces)
        for (const Rgb& p : face.pixels()) EXPECT_LT(p.g, 20) << step;
  }
}

}  // namespace
}  // namespace penumbra::lighting
