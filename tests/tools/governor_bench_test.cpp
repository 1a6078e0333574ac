// What the proof of the governor rests on.
#include "tools/chart/governor/governor_bench.h"
#include "lighting/lighting.h"

#include <gtest/gtest.h>

#include <cmath>

namespace penumbra::tools {

using namespace runtime;
namespace {

TEST(ClopperPearson, AllOfNLeaveTheNthRootOfFivePercent) {
  for (const int n : {1, 5, 10, 59, 200})
    EXPECT_NEAR(clopper_pearson_low(n, n), std::pow(.05, 1. / n), 1e-9) << n;
  EXPECT_NEAR(clopper_pearson_low(59, 59), .9505, 5e-5) << "why 59 scenes calibrate";
  EXPECT_NEAR(clopper_pearson_low(10, 10), .7411, 5e-5);
  EXPECT_LT(clopper_pearson_low(58, 58), .95) << "one less would not do";
}

TEST(ClopperPearson, NoneAndOneOfN) {
  EXPECT_EQ(clopper_pearson_low(0, 10), 0);
  // P(at least one) = 1 - (1 - p)^n.
  EXPECT_NEAR(clopper_pearson_low(1, 10), 1 - std::pow(.95, .1), 1e-9);
}

TEST(ClopperPearson, KnownValues) {
  // Quantiles of Beta(k, n - k + 1) at 5 %.
  EXPECT_NEAR(clopper_pearson_low(9, 10), .6058, 5e-5);
  EXPECT_NEAR(clopper_pearson_low(5, 10), .2224, 5e-5);
  EXPECT_NEAR(clopper_pearson_low(95, 100), .8977, 5e-4);
}

TEST(ClopperPearson, GrowsWithSuccessesAndStaysBelowTheShare) {
  for (int k = 1; k <= 40; ++k) {
    EXPECT_GT(clopper_pearson_low(k, 40), clopper_pearson_low(k - 1, 40));
    EXPECT_LT(clopper_pearson_low(k, 40), k / 40.);
  }
}

// A sun over a floor: no plan without the light predicts well.
ScenePlans sunny(double measured_without, double measured_with) {
  static const RadianceSh residual(kMaxBands);
  lighting::DistantLight sun;
  sun.direction = glm::normalize(glm::dvec3(1, 2, 0));
  sun.radius = Radians(.005);
  sun.radiance = {1e4f, 1e4f, 1e4f};
  ScenePlans out{{{&residual, {&sun, 1}, 512, 1}, {}, 2, 1}, {}};
  for (int bands = 1; bands <= 2; ++bands) {
    out.measured.push_back({{bands, 0, 0}, {measured_without, 0}});
    out.measured.push_back({{bands, 1, 0}, {measured_with, 0}});
    out.measured.push_back({{bands, 1, 1}, {measured_with, 0}});
  }
  return out;
}

double predicted(const ScenePlans& plans, int lights) {
  return plans.predicted.errors({2, lights, 0}).larger();
}

TEST(ScenePlans, LeastFactorKeepsEveryChoiceFromItOn) {
  const lighting::CostModel costs;
  const double kBudget = .5;  // above the prediction without the light
  const ScenePlans honest = sunny(.3, .01);
  ASSERT_LT(predicted(honest, 0), kBudget);
  ASSERT_LT(predicted(honest, 1), predicted(honest, 0) / 2);
  EXPECT_EQ(honest.min_factor(costs, kBudget), 0);
  EXPECT_EQ(honest.choose(costs, kBudget, 1)->lights, 0) << "the cheapest that is promised to do";
  // Worse than predicted: the factor must drive the choice to the light.
  const ScenePlans worse = sunny(.7, .01);
  const double q = worse.min_factor(costs, kBudget);
  EXPECT_NEAR(q, kBudget / predicted(worse, 0), 1e-6);
  EXPECT_EQ(worse.choose(costs, kBudget, q)->lights, 1);
  EXPECT_EQ(worse.min_factor(costs, .8), 0) << "within this budget both are";
  EXPECT_FALSE(worse.choose(costs, 1e-4, 1)) << "no plan is that good";
}

TEST(ScenePlans, RegretIsTheCostOverThatOfTheCheapestThatWouldHaveDone) {
  const lighting::CostModel costs;
  const ScenePlans both_do = sunny(.01, .01), light_needed = sunny(.7, .01), none = sunny(.7, .7);
  const auto plan = both_do.choose(costs, .2, 1);
  ASSERT_TRUE(plan && plan->lights == 1);
  EXPECT_NEAR(*both_do.regret(costs, .2, *plan),
              plan->ms / both_do.predicted.cost({1, 0, 0}, costs).ms(), 1e-9);
  EXPECT_NEAR(*light_needed.regret(costs, .2, *plan), 1, .3);
  EXPECT_FALSE(none.regret(costs, .2, *plan)) << "nothing would have kept it";
}

// The harness itself, on one scene: what it measures falls as more is modelled.
TEST(Trial, MoreLightsAreCloserToTheTruth) {
  const auto scenes = make_trial_scenes({"builtin:box"}, 512);
  ASSERT_TRUE(scenes) << scenes.error().detail;
  ASSERT_EQ(scenes->size(), 3u);
  Image<Rgb> map(512, 256, {.3f, .3f, .3f});
  for (int y = 60; y < 66; ++y)
    for (int x = 100; x < 106; ++x) map.at(x, y) = {900, 900, 900};
  for (const TrialScene& scene : *scenes) {
    const auto trial = Trial::make(scene, map, 600);
    ASSERT_TRUE(trial) << scene.name;
    const auto none = trial->measured({5, 0, 0}), all = trial->measured({5, 1, 1});
    EXPECT_GT(none.shadow, 3 * all.shadow) << scene.name;
    EXPECT_GT(none.object, 1.2 * all.object) << scene.name;
    EXPECT_LT(all.shadow, .05) << scene.name;
    EXPECT_LT(all.object, .06) << scene.name;
    EXPECT_LT(trial->predicted().errors({5, 1, 1}).larger(),
              trial->predicted().errors({5, 0, 0}).larger())
        << scene.name;
  }
}

}  // namespace
}  // namespace penumbra::tools
