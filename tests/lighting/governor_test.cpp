// The governor on tables and lights whose right answer is known.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "lighting/lighting.h"
#include "tests/support/lights.h"

namespace penumbra::lighting {
namespace {

using glm::dvec3;

constexpr std::int64_t kMapNs = 33'333'333;

// Moments over y > 0 of the same radiance everywhere: Y_n over half of the sphere.
RadianceSh moments_above(const RadianceSh& light) {
  constexpr int kWidth = 128, kHeight = 64;
  Image<Rgb> map(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      map.at(x, y) = evaluate(light, latlong_direction(x + .5, y + .5, kWidth, kHeight));
  const auto p = project_latlong(map, kMaxBands);
  EXPECT_TRUE(p);
  return p ? p->upper_moments : RadianceSh(kMaxBands);
}

// What a point of the floor loses to a round object that hides a cap of the sky: pi S_n with the
// cosine, by sampling.
SceneProbes probes_under_caps(std::span<const dvec3> towards, double half_angle_rad) {
  constexpr int kWidth = 128, kHeight = 64;
  SceneProbes probes;
  for (const dvec3& centre : towards) {
    std::array<double, kMaxCoefficients> sum{}, basis{};
    for (int y = 0; y < kHeight / 2; ++y)
      for (int x = 0; x < kWidth; ++x) {
        const dvec3 d = latlong_direction(x + .5, y + .5, kWidth, kHeight);
        if (glm::dot(d, centre) < std::cos(half_angle_rad)) continue;
        evaluate_basis(kMaxBands, d, basis);
        for (std::size_t n = 0; n < basis.size(); ++n)
          sum[n] += latlong_solid_angle(y, kWidth, kHeight) * d.y * basis[n];
      }
    for (const double s : sum) probes.deficit.push_back(static_cast<float>(s));
  }
  return probes;
}

SceneProbes some_probes() {
  std::vector<dvec3> towards;
  for (int i = 0; i < 12; ++i)
    towards.push_back(glm::normalize(dvec3(std::cos(.9 * i), .2 + .1 * i, std::sin(.9 * i))));
  return probes_under_caps(towards, .5);
}

DistantLight sun(double irradiance_up, const dvec3& direction = glm::normalize(dvec3(.5, .8, .3)),
                 double radius = .005) {
  DistantLight d;
  d.id = 1;
  d.direction = direction;
  d.radius = Radians(radius);
  d.radiance = {1, 1, 1};
  d.radiance =
      Rgb{1, 1, 1} * static_cast<float>(irradiance_up / luminance(irradiance(d, dvec3(0, 1, 0))));
  return d;
}

struct Light {
  RadianceSh upper_moments{kMaxBands};
  std::vector<DistantLight> lights;
  ErrorTable table(const SceneProbes& probes, int bands = 9, int max_lights = 8) const {
    return {{&upper_moments, lights}, probes, bands, max_lights};
  }
};

Light uniform() {
  return {moments_above(test::constant_light({1, 1, 1}, kMaxBands)), {}};
}
Light sunny() {
  Light l = uniform();
  l.lights.push_back(sun(5 * kPi));
  return l;
}
// Needs several bands, no light.
Light directional() {
  RadianceSh light = test::constant_light({1, 1, 1}, kMaxBands);
  std::mt19937 rng(3);
  std::normal_distribution<float> gauss(0, .25f);
  for (int n = 1; n < 36; ++n) light[n] = Rgb{1, 1, 1} * gauss(rng);
  return {moments_above(light), {}};
}

// Every coefficient has its price.
const CostModel kBandsCost{.relight_ms = .2, .per_coefficient_ms = .1, .fine_light_ms = 5};

double shadow_error(const ErrorTable& table, int bands, int lights) {
  return table.errors({bands, lights, lights}).shadow;
}
Governor::Limits limits(double budget = .05) {
  return {budget, 9, 8};
}

// -------------------------------------------------------------------------- the prediction

TEST(ErrorTable, UniformLightNeedsOneBand) {
  const ErrorTable table = uniform().table(some_probes());
  EXPECT_EQ(table.max_lights(), 0) << "there are no lights to trace";
  EXPECT_NEAR(shadow_error(table, 1, 0), .008, .001) << "our own steps";
  for (int bands = 2; bands <= 9; ++bands) EXPECT_NEAR(shadow_error(table, bands, 0), .008, .001);
}

TEST(ErrorTable, StrongSunIsWrongInAnyNumberOfBandsAndRightAsALight) {
  const ErrorTable table = sunny().table(some_probes());
  for (int bands = 1; bands <= 9; ++bands) {
    EXPECT_GT(shadow_error(table, bands, 0), .15) << bands;
    EXPECT_LT(shadow_error(table, bands, 1), .05) << bands;
  }
}

TEST(ErrorTable, FallsWithBandsAndWithLightsUpToTheCostOfTracing) {
  const SceneProbes probes = some_probes();
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> uniformly(.05, 1);
  for (int scene = 0; scene < 20; ++scene) {
    Light light = directional();
    const dvec3 up(0, 1, 0);
    double all =
        luminance(evaluate(irradiance(upper_hemisphere_light(light.upper_moments, kMaxBands)), up));
    double traced_square = 0;
    std::vector<double> own;
    for (int k = 0; k < 4; ++k) own.push_back(2 * kPi * uniformly(rng));
    std::ranges::sort(own, std::greater{});
    for (const double e : own) {
      const double azimuth = 6 * uniformly(rng);
      light.lights.push_back(
          sun(e, glm::normalize(dvec3(std::cos(azimuth), .3 + uniformly(rng), std::sin(azimuth))),
              .02 * uniformly(rng)));
      all += e;
      traced_square += e * e;
    }
    const ErrorTable table = light.table(probes);
    const double tracing = .04 * std::sqrt(traced_square) / all;
    for (int lights = 0; lights < table.max_lights(); ++lights)
      EXPECT_LE(shadow_error(table, 9, lights + 1), shadow_error(table, 9, lights) + tracing)
          << scene << ' ' << lights;
    // Fits of the upper hemisphere need not be nested where the probes look: a band more may be
    // worse by a few percent.
    for (int lights = 0; lights <= table.max_lights(); ++lights) {
      for (int bands = 1; bands < 9; ++bands)
        EXPECT_LE(shadow_error(table, bands + 1, lights), 1.1 * shadow_error(table, bands, lights))
            << scene << ' ' << bands << ' ' << lights;
      EXPECT_LE(shadow_error(table, 9, lights), shadow_error(table, 1, lights))
          << scene << ' ' << lights;
    }
  }
}

TEST(ErrorTable, NoProbesOrNoLightGiveNumbers) {
  const Light dark{RadianceSh(kMaxBands), {}};
  for (const Light& light : {dark, uniform(), sunny()})
    for (const SceneProbes& probes : {SceneProbes{}, some_probes()}) {
      const ErrorTable table = light.table(probes);
      for (int lights = 0; lights <= table.max_lights(); ++lights)
        for (int bands = 1; bands <= 9; ++bands) {
          ASSERT_TRUE(std::isfinite(shadow_error(table, bands, lights)));
          ASSERT_GE(shadow_error(table, bands, lights), 0);
        }
      const Plan plan = Governor(limits(), {}).update(table, {});
      EXPECT_TRUE(std::isfinite(plan.error) && std::isfinite(plan.ms));
      EXPECT_GE(plan.bands, 1);
    }
  EXPECT_TRUE(Governor(limits(), {}).update(dark.table(some_probes()), {}).within_budget);
}

// -------------------------------------------------------------------------- the choice

// A plan that keeps the budget for what is seen promises nothing for what is not.
TEST(Governor, WhatNoCameraSeesOfTheSkyCountsInTheError) {
  const Governor governor({.max_error = .05}, {});
  Plan plan;
  plan.error = .03;
  const Plan all = governor.with_unseen(plan, 0), some = governor.with_unseen(plan, .03),
             half = governor.with_unseen(plan, .5);
  EXPECT_EQ(all.error, .03);
  EXPECT_TRUE(all.within_budget && some.within_budget);
  EXPECT_GT(some.error, .03);
  EXPECT_TRUE(half.unseen && !half.within_budget);
  EXPECT_GT(half.error, .15);
  EXPECT_EQ(half.lights, plan.lights) << "no light of the seen part helps";
  EXPECT_GT(half.object_error, .15) << "it lights the objects, too";
  plan.error = .07, plan.within_budget = false;
  EXPECT_FALSE(governor.with_unseen(plan, .5).unseen) << "the plan itself is over";
  plan.error = .03, plan.object_error = .06;
  EXPECT_FALSE(governor.with_unseen(plan, .5).unseen) << "over by its objects";
}

std::vector<Treatment> all_treatments(const ErrorTable& table) {
  std::vector<Treatment> out;
  for (int lights = 0; lights <= table.max_lights(); ++lights)
    for (int fine = 0; fine <= lights; ++fine)
      for (int bands = 1; bands <= table.max_bands(); ++bands)
        for (const int step : {1, kMapBlock}) out.push_back({bands, lights, fine, step});
  return out;
}

TEST(Governor, TakesTheCheapestPlanWithinTheBudget) {
  const SceneProbes probes = some_probes();
  Light mixed = directional();
  mixed.lights = {sun(2 * kPi), sun(.4 * kPi, glm::normalize(dvec3(-.6, .7, .1)))};
  for (const Light& light : {uniform(), sunny(), directional(), mixed})
    for (const double budget : {.02, .05, .1, .3}) {
      const ErrorTable table = light.table(probes);
      const Plan plan = Governor(limits(budget), kBandsCost).update(table, {});
      double cheapest = HUGE_VAL;
      for (const Treatment& t : all_treatments(table))
        if (Governor::kConformalFactor * table.errors(t).larger() <= budget &&
            (t.bands == 9 || (t.bands >= 3 && table.errors_of_bands(t.bands, t.lights).larger() <=
                                                  Governor::kBandsPart * budget)))
          cheapest = std::min(cheapest, table.cost(t, kBandsCost).ms());
      ASSERT_EQ(plan.within_budget, std::isfinite(cheapest));
      EXPECT_DOUBLE_EQ(plan.error, Governor::kConformalFactor * table.errors(plan).shadow);
      EXPECT_DOUBLE_EQ(plan.object_error, Governor::kConformalFactor * table.errors(plan).object);
      EXPECT_DOUBLE_EQ(plan.ms, table.cost(plan, kBandsCost).ms());
      if (plan.within_budget) {
        EXPECT_DOUBLE_EQ(plan.ms, cheapest);
        EXPECT_LE(std::max(plan.error, plan.object_error), budget);
      }
    }
}

// source: CIE S 011, the standard overcast sky: three times as bright in the zenith
TEST(Governor, AnOvercastSkyTakesThreeBandsAndNoLight) {
  Image<Rgb> map(512, 256);
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const double up = latlong_direction(x + .5, y + .5, map.width(), map.height()).y;
      map.at(x, y) = Rgb{1, 1, 1} * static_cast<float>(up > 0 ? (1 + 2 * up) / 3 : .2);
    }
  const auto sky = project_latlong(map, kMaxBands);
  ASSERT_TRUE(sky);
  const ErrorTable table({&sky->upper_moments, {}}, some_probes(), 5, 8);
  const Plan plan = Governor({}, {}).update(table, {});
  EXPECT_EQ(plan.bands, 3);
  EXPECT_EQ(plan.lights, 0);
  EXPECT_EQ(plan.map_step, kMapBlock);
  EXPECT_TRUE(plan.within_budget);
  EXPECT_LE(table.errors_of_bands(plan.bands, 0).larger(), .01);
  EXPECT_EQ(Governor({}, {}).update(directional().table(some_probes(), 5), {}).bands, 5)
      << "what needs them gets them";
}

TEST(Governor, AStrongLightThrowsAFineShadowAndAWeakOneACoarseOne) {
  Light light = uniform();
  light.lights = {sun(8 * kPi), sun(1.5 * kPi, glm::normalize(dvec3(-.6, .7, .1)))};
  // So tight that both are traced.
  Governor::Limits tight = limits();
  tight.max_error =
      1.05 * Governor::kConformalFactor * light.table(some_probes()).errors({9, 2, 1, 1}).larger();
  const Plan plan = Governor(tight, {}).update(light.table(some_probes()), {});
  EXPECT_EQ(plan.lights, 2);
  EXPECT_EQ(plan.fine_lights, 1);
  EXPECT_TRUE(plan.within_budget);
}

TEST(Governor, ASunIsLookedForInTheWholeMapAndAWindowInBlocks) {
  const auto step_for = [](double radius) {
    Light light = uniform();
    light.lights = {sun(2 * kPi, glm::normalize(dvec3(.5, .8, .3)), radius)};
    const Plan plan = Governor({}, {}).update(light.table(some_probes(), 5), {});
    EXPECT_EQ(plan.lights, 1);
    return plan.map_step;
  };
  EXPECT_EQ(step_for(.005), 1);
  EXPECT_EQ(step_for(.1), kMapBlock);
  // What is clipped or hidden is told by pixel.
  const Light even = uniform();
  const ErrorTable by_pixel({&even.upper_moments, {}, 512, 1}, some_probes(), 5, 8);
  EXPECT_EQ(Governor({}, {}).update(by_pixel, {}).map_step, 1);
}

// A light as wide as what a point looks like in blocks counts as a point.
TEST(Governor, WhatBlocksCannotTellCountsAlikeHoweverItWasFound) {
  const auto in_blocks = [](double radius) {
    Light light = uniform();
    light.lights = {sun(2 * kPi, glm::normalize(dvec3(.5, .8, .3)), radius)};
    const ErrorTable table = light.table(some_probes(), 5);
    return table.errors({5, 1, 1, kMapBlock}).shadow - table.errors({5, 1, 1, 1}).shadow;
  };
  const double block = kMapBlock * kPi / 512;
  const double of_a_point = in_blocks(.05 * block);
  EXPECT_GT(of_a_point, .02);
  for (const int blocks : {1, 2, 4})
    EXPECT_NEAR(in_blocks(std::sqrt(blocks / kPi) * block), of_a_point, .02 * of_a_point) << blocks;
  EXPECT_EQ(in_blocks(2 * block), 0);
}

TEST(Governor, WhereNothingIsToldAllBandsAreTaken) {
  const Plan plan = Governor({}, {}).update(uniform().table({}, 5), {});
  EXPECT_EQ(plan.bands, 5);
  EXPECT_TRUE(plan.within_budget);
}

TEST(Governor, WithoutAFloorAShadowCostsNothing) {
  SceneProbes floating = some_probes();
  floating.has_floor = false;
  floating.deficit.clear();
  EXPECT_NEAR(sunny().table(floating, 5).errors({5, 0, 0}).shadow, .008, 1e-6);
}

// The floor may hardly tell that a light is missing where an object does.
TEST(Governor, TheObjectsErrorCountsLikeTheShadows) {
  Light light = uniform();
  light.lights = {sun(.05 * kPi, glm::normalize(dvec3(1, .05, 0)), .05)};  // low
  const SceneProbes floor_only = some_probes();
  SceneProbes probes = floor_only;
  // A wall that faces the light, by its unshadowed transfer.
  probes.transfer_bands = 5;
  std::array<double, 25> basis{};
  evaluate_basis(5, dvec3(1, 0, 0), basis);
  for (int l = 0, n = 0; l < 5; ++l)
    for (int m = -l; m <= l; ++m, ++n)
      probes.transfer.push_back(
          static_cast<float>(cosine_coefficient(l) / kPi * basis[static_cast<std::size_t>(n)]));
  const ErrorTable table = light.table(probes, 5);
  EXPECT_GT(table.errors({5, 0, 0}).object, 2 * table.errors({5, 0, 0}).shadow);
  Governor::Limits limits;
  limits.max_error = 1.1 * Governor::kConformalFactor * table.errors({5, 0, 0}).shadow;
  EXPECT_EQ(Governor(limits, {}).update(light.table(floor_only, 5), {}).lights, 0);
  EXPECT_EQ(Governor(limits, {}).update(table, {}).lights, 1);
}

TEST(Governor, WhatIsTiltedOrBesideARealMeshTakesAllBands) {
  SceneProbes probes = some_probes();
  const Plan upright = Governor({}, {}).update(uniform().table(probes, 5), {});
  probes.level = false;
  const Plan tilted = Governor({}, {}).update(uniform().table(probes, 5), {});
  EXPECT_LT(upright.bands, 5);
  EXPECT_EQ(tilted.bands, 5);
  EXPECT_GT(tilted.error, upright.error);
  probes.level = true, probes.on_planes_only = false;
  EXPECT_EQ(Governor({}, {}).update(uniform().table(probes, 5), {}).bands, 5);
}

TEST(Governor, UniformLightTakesTheFewestBandsAndAStrongSunOneLight) {
  const Plan even = Governor(limits(), kBandsCost).update(uniform().table(some_probes()), {});
  EXPECT_EQ(even.bands, 3);
  EXPECT_EQ(even.lights, 0);
  const Plan sharp = Governor(limits(.1), kBandsCost).update(sunny().table(some_probes()), {});
  EXPECT_EQ(sharp.bands, 3);
  EXPECT_EQ(sharp.lights, 1);
  EXPECT_TRUE(sharp.within_budget);
}

TEST(Governor, NothingThatSufficesIsSaidSoWithTheMostAccurate) {
  const ErrorTable table = sunny().table(some_probes());
  const Plan plan = Governor(limits(.001), kBandsCost).update(table, {});
  EXPECT_FALSE(plan.within_budget);
  for (const Treatment& t : all_treatments(table)) {
    if (t.bands < 3 || table.errors_of_bands(t.bands, t.lights).larger() > .0002) continue;
    EXPECT_LE(std::max(plan.error, plan.object_error),
              Governor::kConformalFactor * table.errors(t).larger());
  }
}

TEST(Governor, LightsThatThereIsNoTimeForGoAtOnceAndComeBackAtOnce) {
  const ErrorTable table = sunny().table(some_probes());
  Governor governor(limits(.1), kBandsCost);
  ASSERT_EQ(governor.update(table, {}).lights, 1);
  governor.allow_lights(0);
  const Plan hurried = governor.update(table, TimestampNs{1'000'000});
  EXPECT_EQ(hurried.lights, 0);
  EXPECT_FALSE(hurried.within_budget);
  EXPECT_TRUE(hurried.time_limited);
  EXPECT_DOUBLE_EQ(hurried.error,
                   Governor::kConformalFactor * shadow_error(table, hurried.bands, 0));
  governor.allow_lights(1);
  const Plan again = governor.update(table, TimestampNs{2'000'000});
  EXPECT_EQ(again.lights, 1);
  EXPECT_FALSE(again.time_limited);
}

TEST(Governor, FewerThanNoLightsAreNone) {
  const ErrorTable table = sunny().table(some_probes());
  Governor governor(limits(.1), kBandsCost);
  governor.allow_lights(-3);
  const Plan plan = governor.update(table, {});
  EXPECT_EQ(plan.lights, 0);
  EXPECT_GT(plan.error, .1);
  EXPECT_TRUE(plan.time_limited);
}

TEST(Governor, TimeIsNoReasonWhereNoLightWouldHelp) {
  Governor governor(limits(), kBandsCost);
  governor.allow_lights(0);
  const Plan plan = governor.update(uniform().table(some_probes()), {});
  EXPECT_TRUE(plan.within_budget);
  EXPECT_FALSE(plan.time_limited);
}

TEST(Governor, NeverLeavesItsLimitsNorTheTables) {
  const SceneProbes probes = some_probes();
  Light light = directional();
  for (int k = 0; k < 6; ++k)
    light.lights.push_back(sun(kPi, glm::normalize(dvec3(std::cos(k), .5, std::sin(k)))));
  for (const int bands : {1, 3, 9})
    for (const int lights : {0, 2, 8}) {
      Governor governor({.001, bands, lights}, kBandsCost);
      for (int i = 0; i < 5; ++i) {
        const Plan plan = governor.update(light.table(probes), {i * kMapNs});
        EXPECT_LE(plan.bands, bands);
        EXPECT_LE(plan.lights, lights);
        EXPECT_GE(plan.bands, 1);
        EXPECT_GE(plan.lights, 0);
      }
      Governor wide(limits(.001), kBandsCost);
      const Plan plan = wide.update(light.table(probes, bands, lights), {});
      EXPECT_LE(plan.bands, bands);
      EXPECT_LE(plan.lights, lights);
    }
}

// -------------------------------------------------------------------------- over time

TEST(Governor, MovesUpAtOnceAndDownAfterTwoSeconds) {
  const SceneProbes probes = some_probes();
  const ErrorTable even = uniform().table(probes), sharp = sunny().table(probes);
  Governor governor(limits(.1), kBandsCost);
  std::int64_t now = 0;
  EXPECT_EQ(governor.update(even, {now}).lights, 0);
  EXPECT_EQ(governor.update(sharp, {now += kMapNs}).lights, 1) << "the sun comes out";
  // The sun is dim but still there: one band would do without it.
  Light dim = uniform();
  dim.lights.push_back(sun(.01 * kPi));
  const ErrorTable little = dim.table(probes);
  const std::int64_t since = now += kMapNs;
  for (; now < since + 2'000'000'000; now += kMapNs)
    ASSERT_EQ(governor.update(little, {now}).lights, 1) << (now - since) * 1e-9;
  EXPECT_EQ(governor.update(little, {now}).lights, 0);
}

// Each map lacks what the other one has too much of: nothing is given up for the other.
TEST(Governor, KnobsThatSwingAgainstEachOtherAreBothTurnedUp) {
  const SceneProbes probes = some_probes();
  Light windows = uniform(), sun_alone = uniform();
  windows.lights = {sun(1.5 * kPi, glm::normalize(dvec3(.5, .8, .3)), .06),
                    sun(1.5 * kPi, glm::normalize(dvec3(-.6, .7, .1)), .06)};
  sun_alone.lights = {sun(1.5 * kPi)};
  const ErrorTable two = windows.table(probes, 5), one = sun_alone.table(probes, 5);
  const Governor fresh({}, {});
  const Plan for_two = fresh.cheapest(two, .05), for_one = fresh.cheapest(one, .05);
  ASSERT_EQ(for_two.lights, 2);
  ASSERT_EQ(for_two.map_step, kMapBlock);
  ASSERT_EQ(for_one.lights, 1);
  ASSERT_EQ(for_one.map_step, 1);
  Governor governor({}, {});
  int changes = 0;
  std::optional<Treatment> last;
  for (int i = 0; i < 50; ++i) {
    const Treatment now = governor.update(i % 2 ? one : two, {i * kMapNs});
    if (last && !(now == *last)) ++changes;
    last = now;
  }
  EXPECT_LE(changes, 1) << "naive: the cheapest of each map";
  EXPECT_EQ(last->lights, 2);
  EXPECT_EQ(last->map_step, 1);
}

TEST(Governor, BandsThatAreNeededNoMoreGoAfterTwoSecondsThoughTheyCostNothing) {
  const SceneProbes probes = some_probes();
  Governor governor({}, {});
  const Plan rich = governor.update(directional().table(probes, 5), {});
  ASSERT_EQ(rich.bands, 5);
  const ErrorTable even = uniform().table(probes, 5);
  for (std::int64_t now = kMapNs; now < 2'000'000'000; now += kMapNs)
    ASSERT_EQ(governor.update(even, {now}).bands, 5);
  EXPECT_EQ(governor.update(even, {2'100'000'000}).bands, 3);
}

TEST(Governor, APixelThatIsClippedChangesTheMapStepAlone) {
  const SceneProbes probes = some_probes();
  Governor governor({}, {});
  const Light light = directional();
  const Plan before = governor.update(light.table(probes, 5), {});
  ASSERT_EQ(before.map_step, kMapBlock);
  const ErrorTable clipped({&light.upper_moments, {}, 512, 1}, probes, 5, 8);
  Treatment expected = before;
  expected.map_step = 1;
  EXPECT_EQ(Treatment(governor.update(clipped, {kMapNs})), expected);
}

TEST(Governor, LightThatIsGoneIsNotCountedOn) {
  const SceneProbes probes = some_probes();
  Governor governor(limits(.1), kBandsCost);
  EXPECT_EQ(governor.update(sunny().table(probes), {}).lights, 1);
  const Plan plan = governor.update(uniform().table(probes), {kMapNs});
  EXPECT_TRUE(std::isfinite(plan.error));
  EXPECT_LE(plan.error, .1);
}

TEST(Governor, DownIsPutOffWheneverTheMarginIsLost) {
  const SceneProbes probes = some_probes();
  Governor governor(limits(.1), kBandsCost);
  const ErrorTable sharp = sunny().table(probes);
  Light dim = uniform();
  dim.lights.push_back(sun(.01 * kPi));
  const ErrorTable little = dim.table(probes);
  std::int64_t now = 0;
  governor.update(sharp, {now});
  // A cloud of one second and a half every other moment.
  for (int moment = 0; moment < 10; ++moment) {
    for (int i = 0; i < 45; ++i) ASSERT_EQ(governor.update(little, {now += kMapNs}).lights, 1);
    ASSERT_EQ(governor.update(sharp, {now += kMapNs}).lights, 1);
  }
}

TEST(Governor, DoesNotFlapWhenTheErrorSwingsAroundTheBudget) {
  const SceneProbes probes = some_probes();
  // Suns of which one band without a light just keeps the budget, and just does not.
  double low = 0, high = kPi;
  const auto alone = [&](double irradiance) {
    Light l = uniform();
    l.lights.push_back(sun(irradiance));
    return l.table(probes);
  };
  for (int i = 0; i < 40; ++i) {
    const double middle = .5 * (low + high);
    (Governor::kConformalFactor * shadow_error(alone(middle), 9, 0) > .1 ? high : low) = middle;
  }
  const ErrorTable below = alone(.97 * low), upper_moments = alone(1.03 * low);
  const CostModel dear_lights{.fine_light_ms = 50, .coarse_light_ms = 50};
  Governor governor(limits(.1), dear_lights);
  int changes = 0, naive_changes = 0;
  std::optional<Plan> last, naive_last;
  for (int i = 0; i < 300; ++i) {  // ten seconds
    const ErrorTable& table = i % 2 ? upper_moments : below;
    const Plan plan = governor.update(table, {i * kMapNs}), naive = governor.cheapest(table, .1);
    if (last) changes += plan.lights != last->lights || plan.bands != last->bands;
    if (naive_last)
      naive_changes += naive.lights != naive_last->lights || naive.bands != naive_last->bands;
    last = plan, naive_last = naive;
    EXPECT_TRUE(plan.within_budget);
  }
  EXPECT_GT(naive_changes, 250) << "the cheapest for every map would do";
  EXPECT_LE(changes, 2) << "a light more, and two seconds later fewer bands beside it";
}

// -------------------------------------------------------------------------- the estimator's part

constexpr int kMapWidth = 128, kMapHeight = 64;

Environment even_map(float sun_radiance, std::int64_t number) {
  Environment e;
  e.radiance = Image<Rgb>(kMapWidth, kMapHeight, {1, 1, 1});
  for (const int x : {40, 41})
    for (const int y : {18, 19}) e.radiance.at(x, y) = Rgb{1, 1, 1} * std::max(1.f, sun_radiance);
  e.time = TimestampNs{number * kMapNs};
  return e;
}

LightEstimator governed_estimator(bool filter) {
  LightEstimator estimator({.filter = filter});
  estimator.set_governor({{}, kBandsCost, some_probes()});
  return estimator;
}

// A window needs no more than blocks of pixels; a lamp that is switched on is found in the next map
// and read as finely as it needs from the one after.
TEST(GovernedEstimator, ReadsAMapInBlocksUntilALampIsNarrowerThanThey) {
  constexpr int kWidth = 1024, kHeight = 512;
  const auto map_at = [](int i, bool lamp) {
    Environment e;
    e.radiance = Image<Rgb>(kWidth, kHeight, {1, 1, 1});
    for (int y = 100; y < 140; ++y)
      for (int x = 200; x < 260; ++x) e.radiance.at(x, y) = {30, 30, 30};
    if (lamp)
      for (const int x : {703, 704})  // on the corner of four blocks, which looks widest
        for (const int y : {151, 152}) e.radiance.at(x, y) = {300000, 300000, 300000};
    e.time = TimestampNs{i * kMapNs};
    return e;
  };
  LightEstimator estimator({.filter = false});
  estimator.set_governor({{}, {}, some_probes()});
  const auto first = estimator.estimate(map_at(0, false)),
             blocks = estimator.estimate(map_at(1, false));
  ASSERT_TRUE(first && blocks);
  EXPECT_EQ(first->plan->map_step, kMapBlock) << "what the first map says of the next";
  ASSERT_EQ(blocks->lights.size(), 1u);
  EXPECT_NEAR(blocks->lights[0].radius.value(), first->lights[0].radius.value(), .003);
  EXPECT_LT(glm::distance(blocks->lights[0].direction, first->lights[0].direction), 1e-3);
  for (int n = 0; n < 9; ++n)
    EXPECT_NEAR(whole_light(*blocks)[n].g, whole_light(*first)[n].g, .002f * first->light[0].g)
        << n;
  const auto lit = estimator.estimate(map_at(2, true)), fine = estimator.estimate(map_at(3, true));
  ASSERT_TRUE(lit && fine);
  ASSERT_EQ(lit->lights.size(), 2u) << "at once";
  EXPECT_EQ(lit->plan->map_step, 1);
  const auto radius_of_lamp = [](const LightEstimate& e) { return e.lights[0].radius.value(); };
  EXPECT_GT(radius_of_lamp(*lit), 1.5 * radius_of_lamp(*fine)) << "naive: blocks for ever";
  const auto exact = estimate_map(map_at(0, true).radiance, {});
  ASSERT_TRUE(exact);
  EXPECT_DOUBLE_EQ(radius_of_lamp(*fine), radius_of_lamp(*exact));
  // A new light fades in, from the harmonics.
  EXPECT_NEAR(whole_light(*lit)[0].g, whole_light(*exact)[0].g, .002f * whole_light(*exact)[0].g)
      << "nothing of it is lost";
}

TEST(GovernedEstimator, ANonFinitePixelIsNamedAsItCameAlsoInBlocks) {
  LightEstimator estimator({.map_step = kMapBlock});
  Environment e;
  e.radiance = Image<Rgb>(1024, 512, {1, 1, 1});
  e.radiance.at(517, 301).g = std::numeric_limits<float>::quiet_NaN();
  const auto refused = estimator.estimate(e);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kNonFinite);
  EXPECT_NE((refused.error().where + refused.error().detail).find("517"), std::string::npos)
      << refused.error().where << ' ' << refused.error().detail;
}

// A fisheye that looks ahead sees half of the sky, one that looks up all of it.
TEST(GovernedEstimator, ThePlanCountsWhatNoCameraSeesOfTheSky) {
  const auto plan_where = [](const auto& is_seen) {
    Environment e = even_map(1, 0);
    e.confidence = Image<float>(kMapWidth, kMapHeight);
    for (int y = 0; y < kMapHeight; ++y)
      for (int x = 0; x < kMapWidth; ++x) {
        const bool seen = is_seen(latlong_direction(x + .5, y + .5, kMapWidth, kMapHeight));
        e.confidence.at(x, y) = seen ? 1 : 0;
        if (!seen) e.radiance.at(x, y) = {};
      }
    LightEstimator estimator = governed_estimator(false);
    const auto estimate = estimator.estimate(e);
    EXPECT_TRUE(estimate && estimate->plan);
    EXPECT_NEAR(estimate->coverage, .5, .01);
    return *estimate->plan;
  };
  const Plan ahead = plan_where([](const glm::dvec3&d) { return d.z < 0; }),
             up = plan_where([](const glm::dvec3&d) { return d.y > 0; });
  EXPECT_TRUE(ahead.unseen && !ahead.within_budget);
  EXPECT_NEAR(ahead.error, Governor::kConformalFactor * Governor::kUnseen * .5, .02);
  EXPECT_FALSE(up.unseen);
  EXPECT_TRUE(up.within_budget);
}

// The estimate itself keeps them, for those who light other things by it.
TEST(GovernedEstimator, WithoutTimeForLightsFramesHaveAllLightInHarmonics) {
  for (const bool filter : {false, true}) {
    LightEstimator estimator = governed_estimator(filter);
    const auto before = estimator.estimate(even_map(3000, 0));
    ASSERT_TRUE(before);
    ASSERT_EQ(before->lights.size(), 1u);
    estimator.allow_lights(0);
    const double all = double(whole_light(*before)[0].g);
    const RadianceSh whole = whole_light(*before);
    for (int i = 1; i < 30; ++i) {
      auto e = estimator.estimate(even_map(3000, i));
      ASSERT_TRUE(e && e->plan);
      EXPECT_EQ(e->plan->lights, 0);
      EXPECT_TRUE(e->plan->time_limited);
      ASSERT_EQ(e->lights.size(), 1u);
      EXPECT_EQ(e->lights[0].id, before->lights[0].id);
      EXPECT_NEAR(e->lights[0].radiance.g, before->lights[0].radiance.g,
                  .001 * double(before->lights[0].radiance.g));
      EXPECT_TRUE(e->truncation_error);
      const RadianceSh upper = whole_upper_hemisphere_light(*e);
      keep_affordable(*e);
      EXPECT_TRUE(e->lights.empty());
      EXPECT_FALSE(e->truncation_error) << "what else of the light left out nobody knows";
      // A light is not quite the pixels that it was cut from.
      EXPECT_NEAR(e->light[0].g, all, .002 * all) << "map " << i;
      for (int n = 0; n < std::min(whole.size(), e->light.size()); ++n) {
        EXPECT_NEAR(e->light[n].g, whole[n].g, .005 * all) << "map " << i;
        EXPECT_NEAR(e->upper_hemisphere_light[n].g, upper[n].g, 1e-5 * all) << "map " << i;
      }
    }
    estimator.allow_lights(8);
    const auto after = estimator.estimate(even_map(3000, 30));
    ASSERT_TRUE(after);
    EXPECT_EQ(after->lights.size(), 1u);
    EXPECT_FALSE(after->plan->time_limited);
  }
}

TEST(GovernedEstimator, WithoutTimeForLightsASwitchedLampIsStillFollowedAtOnce) {
  LightEstimator estimator = governed_estimator(false);
  estimator.allow_lights(0);
  for (int i = 0; i < 20; ++i) {
    const float radiance = i % 3 == 0 ? 3000.f : 1.f;
    auto e = estimator.estimate(even_map(radiance, i));
    ASSERT_TRUE(e);
    keep_affordable(*e);
    const auto whole = project_latlong(even_map(radiance, i).radiance, kMaxBands);
    ASSERT_TRUE(whole);
    EXPECT_NEAR(e->light[0].g, whole->light[0].g, .002f * whole->light[0].g) << "map " << i;
  }
}

TEST(GovernedEstimator, ThePlanIsThatOfTheLightAlsoWhenClippingEnds) {
  LightEstimator estimator = governed_estimator(true);
  estimator.allow_lights(0);
  for (int i = 0; i < 40; ++i) {
    Environment map = even_map(50, i);
    if (i / 12 % 2 == 0)
      for (const std::uint32_t y : {18u, 19u})
        for (const std::uint32_t x : {40u, 41u}) map.clipped.push_back(y * kMapWidth + x);
    auto e = estimator.estimate(map);
    ASSERT_TRUE(e);
    keep_affordable(*e);
    EXPECT_EQ(e->plan->lights, static_cast<int>(e->lights.size())) << "map " << i;
    const auto whole = project_latlong(map.radiance, kMaxBands);
    ASSERT_TRUE(whole);
    EXPECT_NEAR(whole_light(*e)[0].g, whole->light[0].g, .002f * whole->light[0].g) << "map " << i;
  }
}

// The weak one is clipped: it is drawn finely and paid for, as are those before it.
TEST(GovernedEstimator, WhatIsClippedIsPaidFor) {
  Environment map = even_map(3000, 0);
  for (const int x : {90, 91})
    for (const int y : {20, 21}) map.radiance.at(x, y) = {12, 12, 12};
  for (const std::uint32_t y : {20u, 21u})
    for (const std::uint32_t x : {90u, 91u}) map.clipped.push_back(y * kMapWidth + x);
  LightEstimator estimator = governed_estimator(false);
  const auto e = estimator.estimate(map);
  ASSERT_TRUE(e && e->plan);
  ASSERT_EQ(e->lights.size(), 2u);
  EXPECT_EQ(e->plan->lights, 2);
  EXPECT_EQ(e->plan->fine_lights, 2);
  EXPECT_GT(e->plan->cost.lights_ms, kBandsCost.fine_light_ms) << "both";
  EXPECT_DOUBLE_EQ(e->plan->ms, e->plan->cost.ms());
}

TEST(GovernedEstimator, WhatIsClippedStaysALightWhateverTheTime) {
  LightEstimator estimator = governed_estimator(false);
  estimator.allow_lights(0);
  for (int i = 0; i < 12; ++i) {
    Environment map = even_map(50, i);
    for (const std::uint32_t y : {18u, 19u})
      for (const std::uint32_t x : {40u, 41u}) map.clipped.push_back(y * kMapWidth + x);
    const auto e = estimator.estimate(map);
    ASSERT_TRUE(e);
    ASSERT_EQ(e->lights.size(), 1u) << "map " << i;
    EXPECT_TRUE(e->lights[0].clipped);
  }
}

}  // namespace
}  // namespace penumbra::lighting
