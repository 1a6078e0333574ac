// The governor on tables and lights whose right answer is known.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
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
ShadowProbes probes_under_caps(std::span<const dvec3> towards, double half_angle_rad) {
  constexpr int kWidth = 128, kHeight = 64;
  ShadowProbes probes;
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

ShadowProbes some_probes() {
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
  ErrorTable table(const ShadowProbes& probes, int bands = 9, int max_lights = 8) const {
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

const CostModel kBandsCost{.2, .1, 5};  // every coefficient has its price
Governor::Limits limits(double budget = .05) {
  return {budget, 9, 8};
}

// -------------------------------------------------------------------------- the prediction

TEST(ErrorTable, UniformLightNeedsOneBand) {
  const ErrorTable table = uniform().table(some_probes());
  EXPECT_EQ(table.max_lights(), 0) << "there are no lights to trace";
  EXPECT_NEAR(table.error(1, 0), .008, .001) << "our own steps";
  for (int bands = 2; bands <= 9; ++bands) EXPECT_NEAR(table.error(bands, 0), .008, .001);
}

TEST(ErrorTable, StrongSunIsWrongInAnyNumberOfBandsAndRightAsALight) {
  const ErrorTable table = sunny().table(some_probes());
  for (int bands = 1; bands <= 9; ++bands) {
    EXPECT_GT(table.error(bands, 0), .15) << bands;
    EXPECT_LT(table.error(bands, 1), .05) << bands;
  }
}

TEST(ErrorTable, FallsWithBandsAndWithLightsUpToTheCostOfTracing) {
  const ShadowProbes probes = some_probes();
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
    const double tracing = .035 * std::sqrt(traced_square) / all;
    for (int lights = 0; lights < table.max_lights(); ++lights)
      EXPECT_LE(table.error(9, lights + 1), table.error(9, lights) + tracing)
          << scene << ' ' << lights;
    // Fits of the upper hemisphere need not be nested where the probes look: a band more may be
    // worse by a few percent.
    for (int lights = 0; lights <= table.max_lights(); ++lights) {
      for (int bands = 1; bands < 9; ++bands)
        EXPECT_LE(table.error(bands + 1, lights), 1.1 * table.error(bands, lights))
            << scene << ' ' << bands << ' ' << lights;
      EXPECT_LE(table.error(9, lights), table.error(1, lights)) << scene << ' ' << lights;
    }
  }
}

TEST(ErrorTable, NoProbesOrNoLightGiveNumbers) {
  const Light dark{RadianceSh(kMaxBands), {}};
  for (const Light& light : {dark, uniform(), sunny()})
    for (const ShadowProbes& probes : {ShadowProbes{}, some_probes()}) {
      const ErrorTable table = light.table(probes);
      for (int lights = 0; lights <= table.max_lights(); ++lights)
        for (int bands = 1; bands <= 9; ++bands) {
          ASSERT_TRUE(std::isfinite(table.error(bands, lights)));
          ASSERT_GE(table.error(bands, lights), 0);
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
  const Governor governor({.budget = .05}, {});
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
  plan.error = .07, plan.within_budget = false;
  EXPECT_FALSE(governor.with_unseen(plan, .5).unseen) << "the plan itself is over";
}

TEST(Governor, TakesTheCheapestPlanWithinTheBudget) {
  const ShadowProbes probes = some_probes();
  Light mixed = directional();
  mixed.lights = {sun(2 * kPi), sun(.4 * kPi, glm::normalize(dvec3(-.6, .7, .1)))};
  for (const Light& light : {uniform(), sunny(), directional(), mixed})
    for (const double budget : {.02, .05, .1, .3}) {
      const ErrorTable table = light.table(probes);
      const Plan plan = Governor(limits(budget), kBandsCost).update(table, {});
      double cheapest = HUGE_VAL;
      for (int lights = 0; lights <= table.max_lights(); ++lights)
        for (int bands = 1; bands <= 9; ++bands)
          if (Governor::kConformalFactor * table.error(bands, lights) <= budget)
            cheapest = std::min(cheapest, kBandsCost.ms(bands, lights));
      ASSERT_EQ(plan.within_budget, std::isfinite(cheapest));
      EXPECT_DOUBLE_EQ(plan.error,
                       Governor::kConformalFactor * table.error(plan.bands, plan.lights));
      EXPECT_DOUBLE_EQ(plan.ms, kBandsCost.ms(plan.bands, plan.lights));
      if (plan.within_budget) {
        EXPECT_DOUBLE_EQ(plan.ms, cheapest);
        EXPECT_LE(plan.error, budget);
      }
    }
}

TEST(Governor, UniformLightTakesOneBandAndAStrongSunOneLight) {
  const Plan even = Governor(limits(), kBandsCost).update(uniform().table(some_probes()), {});
  EXPECT_EQ(even.bands, 1);
  EXPECT_EQ(even.lights, 0);
  const Plan sharp = Governor(limits(.1), kBandsCost).update(sunny().table(some_probes()), {});
  EXPECT_EQ(sharp.bands, 1);
  EXPECT_EQ(sharp.lights, 1);
  EXPECT_TRUE(sharp.within_budget);
}

TEST(Governor, BandsThatCostNextToNothingAreAllTaken) {
  const CostModel cheap{.2, .001, 5};
  const Plan plan = Governor(limits(), cheap).update(uniform().table(some_probes()), {});
  EXPECT_EQ(plan.bands, 9);
}

TEST(Governor, NothingThatSufficesIsSaidSoWithTheMostAccurate) {
  const ErrorTable table = sunny().table(some_probes());
  const Plan plan = Governor(limits(.001), kBandsCost).update(table, {});
  EXPECT_FALSE(plan.within_budget);
  for (int lights = 0; lights <= table.max_lights(); ++lights)
    for (int bands = 1; bands <= 9; ++bands)
      EXPECT_LE(plan.error, Governor::kConformalFactor * table.error(bands, lights));
}

// One band may predict a shadow that is no worse; the object is not in the prediction.
TEST(Governor, WhereNothingSufficesBandsThatCostNothingAreStillTaken) {
  const CostModel cheap{.2, .001, 5};
  const Plan plan = Governor(limits(1e-6), cheap).update(uniform().table(some_probes()), {});
  EXPECT_FALSE(plan.within_budget);
  EXPECT_EQ(plan.bands, 9);
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
  EXPECT_DOUBLE_EQ(hurried.error, Governor::kConformalFactor * table.error(hurried.bands, 0));
  for (int bands = 1; bands <= 9; ++bands)
    EXPECT_LE(hurried.error, Governor::kConformalFactor * table.error(bands, 0))
        << "the most accurate";
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
  const ShadowProbes probes = some_probes();
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
  const ShadowProbes probes = some_probes();
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

TEST(Governor, LightThatIsGoneIsNotCountedOn) {
  const ShadowProbes probes = some_probes();
  Governor governor(limits(.1), kBandsCost);
  EXPECT_EQ(governor.update(sunny().table(probes), {}).lights, 1);
  const Plan plan = governor.update(uniform().table(probes), {kMapNs});
  EXPECT_TRUE(std::isfinite(plan.error));
  EXPECT_LE(plan.error, .1);
}

TEST(Governor, DownIsPutOffWheneverTheMarginIsLost) {
  const ShadowProbes probes = some_probes();
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
  const ShadowProbes probes = some_probes();
  // Suns of which one band without a light just keeps the budget, and just does not.
  double low = 0, high = kPi;
  const auto alone = [&](double irradiance) {
    Light l = uniform();
    l.lights.push_back(sun(irradiance));
    return l.table(probes);
  };
  for (int i = 0; i < 40; ++i) {
    const double middle = .5 * (low + high);
    (Governor::kConformalFactor * alone(middle).error(9, 0) > .1 ? high : low) = middle;
  }
  const ErrorTable below = alone(.97 * low), upper_moments = alone(1.03 * low);
  Governor governor(limits(.1), kBandsCost);
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
  EXPECT_LE(changes, 1);
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

TEST(GovernedEstimator, WithoutTimeForLightsAllLightIsInHarmonics) {
  for (const bool filter : {false, true}) {
    LightEstimator estimator = governed_estimator(filter);
    const auto before = estimator.estimate(even_map(3000, 0));
    ASSERT_TRUE(before);
    ASSERT_EQ(before->lights.size(), 1u);
    estimator.allow_lights(0);
    const double all = double(whole_light(*before)[0].g);
    float last = 0;
    for (int i = 1; i < 30; ++i) {
      const auto e = estimator.estimate(even_map(3000, i));
      ASSERT_TRUE(e);
      EXPECT_TRUE(e->lights.empty());
      ASSERT_TRUE(e->plan);
      EXPECT_EQ(e->plan->lights, 0);
      EXPECT_TRUE(e->plan->time_limited);
      if (i > 9) {  // calm for eight maps
        EXPECT_EQ(e->light[7].g, last) << "map " << i << ": a glance at lights changes nothing";
      }
      last = e->light[7].g;
      // A light is not quite the pixels that it was cut from.
      EXPECT_NEAR(e->light[0].g, all, .002 * all) << "map " << i;
      for (int n = 0; n < 25; ++n)
        EXPECT_NEAR(e->light[n].g, whole_light(*before)[n].g, .005 * all) << "map " << i;
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
    const auto e = estimator.estimate(even_map(radiance, i));
    ASSERT_TRUE(e);
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
    const auto e = estimator.estimate(map);
    ASSERT_TRUE(e);
    EXPECT_EQ(e->plan->lights, static_cast<int>(e->lights.size())) << "map " << i;
    const auto whole = project_latlong(map.radiance, kMaxBands);
    ASSERT_TRUE(whole);
    EXPECT_NEAR(whole_light(*e)[0].g, whole->light[0].g, .002f * whole->light[0].g) << "map " << i;
  }
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
