// Reflection maps against closed forms and against the lobe's integral.
#include "lighting/reflections/reflection_map.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <glm/geometric.hpp>
#include <initializer_list>
#include <string>

#include "core/conventions.h"
#include "core/environment.h"
#include "lighting/estimate.h"
#include "lighting/reflections/ggx.h"
#include "lighting/reflections/octahedral_map.h"

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

SurfaceRoughness single(std::initializer_list<float> roughness) {
  SurfaceRoughness out;
  for (const float r : roughness) out.add(r);
  return out;
}

SurfaceRoughness range(float least, float most) {
  SurfaceRoughness out;
  out.add_range(least, most);
  return out;
}

ReflectionMap filtered(const Image<Rgb>& map, const SurfaceRoughness& asked) {
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

TEST(OctahedralMaps, APlaceAndItsDirectionAreOne) {
  for (const float s : {.01f, .3f, .5f, .77f, .99f})
    for (const float t : {.02f, .45f, .6f, .98f}) {
      const glm::vec3 d = octahedral_direction({s, t});
      EXPECT_NEAR(glm::length(d), 1, 1e-6);
      const glm::vec2 at = octahedral_place(d);
      EXPECT_NEAR(at.x, s, 1e-5);
      EXPECT_NEAR(at.y, t, 1e-5);
    }
  EXPECT_NEAR(octahedral_direction({.5f, .5f}).y, 1, 1e-6);
  EXPECT_NEAR(octahedral_direction({0, 1}).y, -1, 1e-6);
}

// A smooth picture is read smoothly across the folds, up to whose very edge directions go.
TEST(OctahedralMaps, FoldsDoNotShow) {
  constexpr int kSize = 64;
  Image<Rgb> picture(kSize, kSize);
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const glm::vec3 d = octahedral_direction((glm::vec2(x, y) + .5f) / float(kSize));
      picture.at(x, y) = {2 + d.x, 2 + d.y, 2 + d.z};
    }
  double worst = 0;
  for (int i = 0; i < 20'000; ++i) {
    const double z = 1 - 2 * (i + .5) / 20'000, phi = 2.399963 * i, r = std::sqrt(1 - z * z);
    const glm::vec3 d(r * std::cos(phi), z, r * std::sin(phi));
    const Rgb c = sample_octahedral(picture, d);
    worst = std::max(
        {worst, std::abs(c.r - 2. - d.x), std::abs(c.g - 2. - d.y), std::abs(c.b - 2. - d.z)});
  }
  EXPECT_LT(worst, .03);
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
  const ReflectionMap map = filtered(even, range(0, 1));
  ASSERT_GT(map.levels.size(), 4U);
  for (const ReflectionMap::RoughnessLevel& level : map.levels)
    for (const Rgb& p : level.picture.pixels()) {
      EXPECT_NEAR(p.r, .5, 1e-5);
      EXPECT_NEAR(p.b, 2, 1e-5);
    }
}

TEST(ReflectionMaps, AMirrorShowsTheMap) {
  const Image<Rgb> room = make_room(1024, 512);
  const ReflectionMap map = filtered(room, single({0}));
  ASSERT_EQ(map.levels.size(), 1U);
  double off = 0;
  int count = 0;
  for (int y = 8; y < 504; y += 7)
    for (int x = 3; x < 1024; x += 11, ++count) {
      const Rgb shown =
          sample_octahedral(map.levels[0].picture, latlong_direction(x + .5, y + .5, 1024, 512));
      off += std::abs(shown.g - room.at(x, y).g) > .05 * room.at(x, y).g ? 1 : 0;
    }
  EXPECT_LT(off / count, .02);  // but for the edges of the window and the lamp
}

TEST(ReflectionMaps, EachLevelIsTheMeanOverItsLobe) {
  const Image<Rgb> room = make_room(512, 256);
  const ReflectionMap map = filtered(room, single({.15f, .3f, .5f, 1}));
  ASSERT_EQ(map.levels.size(), 7U);  // three with narrower lobes
  for (const ReflectionMap::RoughnessLevel& level : map.levels) {
    double squares = 0, mean = 0;
    constexpr int kCount = 80;
    for (int i = 0; i < kCount; ++i) {
      const double z = 1 - 2 * (i + .5) / kCount, phi = 2.399963 * i, r = std::sqrt(1 - z * z);
      const glm::vec3 d(r * std::cos(phi), z, r * std::sin(phi));
      const Rgb truth = lobe_mean(room, d, level.roughness);
      const double error = sample_octahedral(level.picture, d).g - truth.g;
      squares += error * error, mean += truth.g / kCount;
    }
    const double error = std::sqrt(squares / kCount) / mean;
    RecordProperty("relative_rms_percent_" + std::to_string(level.roughness),
                   std::to_string(100 * error));
    EXPECT_LT(error, .07) << level.roughness;
  }
}

// The naive way, even steps of roughness, mixes a lamp's sharp picture with a blurred one.
TEST(ReflectionMaps, ARoughnessOfItsOwnHasItsOwnLevelAndPicturesHaveCloseOnes) {
  const Image<Rgb> room = make_room(512, 256);
  const glm::vec3 lamp = glm::normalize(glm::vec3(-1, 2, 1));
  const auto error_of = [&](const ReflectionMap& map, float roughness) {
    const float place = map.place_of(roughness);
    const auto low = std::min(std::size_t(place), map.levels.size() - 1),
               high = std::min(low + 1, map.levels.size() - 1);
    const auto t = place - float(low);
    const Rgb shown = sample_octahedral(map.levels[low].picture, lamp) * (1 - t) +
                      sample_octahedral(map.levels[high].picture, lamp) * t;
    return std::abs(shown.g / lobe_mean(room, lamp, roughness).g - 1);
  };
  EXPECT_LT(error_of(filtered(room, single({.23f, .6f})), .23f), .03);
  const ReflectionMap steps = filtered(room, range(.1f, .8f)),
                      naive = filtered(room, single({1.f / 6, 2.f / 6}));
  for (const float r : {.2f, .23f, .3f, .45f}) EXPECT_LT(error_of(steps, r), .13) << r;
  EXPECT_GT(error_of(naive, .23f), .08);
}

// A lamp of a thousand times the room's radiance: samples of a lobe find it or not.
TEST(ReflectionMaps, ASmallLampIsAsBrightAsItsLobeSays) {
  // Towards the folds' edges too, and before rough surfaces alone, whose pictures are coarse.
  for (const glm::dvec3& towards : {glm::dvec3(.3, .5, -.8), glm::dvec3(.05, -.02, -1)}) {
    Image<Rgb> room = make_room(1024, 512);
    const glm::dvec3 lamp = glm::normalize(towards);
    for (int y = 0; y < 512; ++y)
      for (int x = 0; x < 1024; ++x)
        if (glm::dot(latlong_direction(x + .5, y + .5, 1024, 512), lamp) > std::cos(.008))
          room.at(x, y) = {900, 900, 900};
    const ReflectionMap maps[] = {filtered(room, single({0, .25f, .6f})),
                                  filtered(room, single({.5f})), filtered(room, single({1}))};
    for (const ReflectionMap& map : maps)
      for (const ReflectionMap::RoughnessLevel& level : map.levels)
        for (const double off : {0., .5, 1., 2.}) {  // in widths of the lobe
          if (level.roughness < .1f) continue;
          const double angle = off * level.roughness * level.roughness;
          const glm::dvec3 aside = glm::normalize(glm::cross(lamp, glm::dvec3(0, 1, 0)));
          const glm::vec3 d(std::cos(angle) * lamp + std::sin(angle) * aside);
          const double truth = lobe_mean(room, d, level.roughness).g;
          EXPECT_NEAR(sample_octahedral(level.picture, d).g, truth, .13 * truth)
              << level.roughness << ' ' << off << ' ' << lamp.y;
        }
  }
}

TEST(ReflectionMaps, AreAsFewAndAsSmallAsTheSurfacesAsk) {
  const auto levels = [](const SurfaceRoughness& r) { return r.levels(); };
  EXPECT_TRUE(SurfaceRoughness().empty());
  EXPECT_EQ(levels(single({.1f, .1f, .1005f})).size(), 1U);
  EXPECT_EQ(levels(single({.5f})).size(), 2U);            // and a narrower lobe
  EXPECT_EQ(levels(single({0, .03f, .05f})).size(), 1U);  // all are mirrors
  EXPECT_EQ(levels(range(.1f, .1f)).size(), 1U);
  EXPECT_LE(levels(range(.4f, .6f)).size(), 5U);
  SurfaceRoughness many;
  for (int i = 0; i <= 20; ++i) many.add(.05f * float(i));
  many.add_range(.3f, .9f);
  for (const SurfaceRoughness& r : {many, range(0, 1)}) {
    EXPECT_LE(levels(r).size(), ReflectionMap::kMaxLevels);
    EXPECT_TRUE(std::ranges::is_sorted(levels(r)));
    EXPECT_NEAR(levels(r).back(), 1, 1e-3);
  }
  const ReflectionMap map = filtered(make_room(256, 128), single({.15f, 1}));
  ASSERT_EQ(map.levels.size(), 3U);
  EXPECT_EQ(map.levels[0].picture.width(), 320);
  EXPECT_EQ(map.levels[2].picture.width(), 10);
}

TEST(ReflectionMaps, WhatIsBrighterThanHalfPrecisionStaysFinite) {
  Image<Rgb> map(256, 128);
  std::ranges::fill(map.pixels(), Rgb{1e6f, 1, 0});
  Image<Rgb> spot(256, 128);
  spot.at(40, 50) = {1e8f, 1e8f, 1e8f};
  for (const Image<Rgb>& bright : {map, spot}) {
    const ReflectionMap out = filtered(bright, single({0, .1f, .5f}));
    for (const ReflectionMap::RoughnessLevel& level : out.levels)
      for (const Rgb& p : level.picture.pixels()) ASSERT_LT(p.r, 65'504);
  }
}

TEST(ReflectionMaps, WhatWasNotSeenShowsTheLightThere) {
  Image<Rgb> map(256, 128);
  Image<float> confidence(256, 128);
  for (int y = 0; y < 64; ++y)
    for (int x = 0; x < 256; ++x) map.at(x, y) = {1, 1, 1}, confidence.at(x, y) = 1;
  RadianceSh light(1);
  light[0] = Rgb{.5f, .5f, .5f} * static_cast<float>(std::sqrt(4 * kPi));
  ReflectionMap out;
  ReflectionFilter(single({0})).filter(map, confidence, light, out);
  EXPECT_NEAR(sample_octahedral(out.levels[0].picture, {0, 1, 0}).g, 1, 1e-5);
  EXPECT_NEAR(sample_octahedral(out.levels[0].picture, {0, -1, 0}).g, .5, 1e-5);
}

// A sun over stripes that are finer than a block of the map.
Environment sun_over_stripes(double radius_rad = .01) {
  Environment out;
  out.radiance = Image<Rgb>(1024, 512);
  for (int y = 0; y < 512; ++y)
    for (int x = 0; x < 1024; ++x) {
      const glm::dvec3 d = latlong_direction(x + .5, y + .5, 1024, 512);
      const bool sun = glm::dot(d, glm::normalize(glm::dvec3(1, 1, -1))) > std::cos(radius_rad);
      const float stripe = x / 2 % 2 == 0 ? .5f : 1.5f;
      out.radiance.at(x, y) = sun ? Rgb{9000, 9000, 9000} : Rgb{stripe, stripe, stripe};
    }
  return out;
}

TEST(ReflectionMaps, LightThatIsReadInBlocksIsMirroredByPixels) {
  for (const int step : {1, kMapBlock}) {
    LightEstimator estimator({.bands = 3, .filter = false, .map_step = step});
    estimator.mirror(single({0}));
    const auto light = estimator.estimate(sun_over_stripes());
    ASSERT_TRUE(light);
    ASSERT_TRUE(light->reflections);
    float dark = 10, bright = 0;
    for (int x = 500; x < 520; ++x) {
      const Rgb c = sample_octahedral(light->reflections->levels[0].picture,
                                      latlong_direction(x + .5, 256.5, 1024, 512));
      dark = std::min(dark, c.g), bright = std::max(bright, c.g);
    }
    EXPECT_LT(dark, .8f) << step;
    EXPECT_GT(bright, 1.2f) << step;
  }
}

// A lamp of some degrees is a picture in a mirror, and a disc before a lobe that is wider.
TEST(ReflectionMaps, ALampIsApartWhereNoSurfaceShowsItsForm) {
  const Environment room = sun_over_stripes(.06);
  for (const auto& [smoothest, apart] : {std::pair{.25f, 1U}, {.05f, 0U}}) {
    LightEstimator estimator({.bands = 3, .filter = false});
    estimator.mirror(single({smoothest, .5f}));
    const auto light = estimator.estimate(room);
    ASSERT_TRUE(light);
    EXPECT_EQ(lights_apart(*light).size(), apart) << smoothest;
    float brightest = 0;
    for (const Rgb& p : light->reflections->levels.back().picture.pixels())
      brightest = std::max(brightest, p.g);
    EXPECT_EQ(brightest < 20, apart == 1) << smoothest;
  }
}

// A sun behind thin cloud is a blot, which its lobes hide; a tube is none.
TEST(ReflectionMaps, WhatIsCompactIsApartWhateverItsForm) {
  for (const bool tube : {false, true}) {
    LightEstimate light;
    DistantLight& one = light.lights.emplace_back();
    one.direction = {0, 0, -1};
    one.radius = Radians(.02);
    for (int i = 0; i < DistantLight::kShapePoints; ++i) {
      const double along = (i + .5) / DistantLight::kShapePoints - .5;
      const glm::dvec3 blot(.03 * std::sin(37. * i), .03 * along, -1), line(.16 * along, 0, -1);
      one.shape.push_back(glm::normalize(tube ? line : blot));
    }
    EXPECT_EQ(lights_apart(light).size(), tube ? 0U : 1U);
  }
}

TEST(ReflectionMaps, WhatIsMirroredApartIsNotInThem) {
  for (const int step : {1, kMapBlock}) {
    LightEstimator estimator({.bands = 3, .filter = false, .map_step = step});
    estimator.mirror(single({0, .5f}));
    const auto light = estimator.estimate(sun_over_stripes());
    ASSERT_TRUE(light);
    ASSERT_EQ(lights_apart(*light).size(), 1U) << step;
    for (const ReflectionMap::RoughnessLevel& level : light->reflections->levels)
      for (const Rgb& p : level.picture.pixels()) EXPECT_LT(p.g, 20) << step;
  }
}

}  // namespace
}  // namespace penumbra::lighting
