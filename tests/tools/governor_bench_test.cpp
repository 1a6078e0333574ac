// What the proof of the governor rests on.
#include "tools/chart/governor_bench.h"
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
  const lighting::ShadowProbes none;
  ScenePlans out{1, {{&residual, {&sun, 1}}, none, 2, 1}, {}};
  out.measured = {measured_without, measured_without, measured_with, measured_with};
  return out;
}

TEST(ScenePlans, LeastFactorKeepsEveryChoiceFromItOn) {
  const lighting::CostModel costs{.1, .01, 5};
  const double kBudget = .5;  // above the prediction without the light
  const ScenePlans honest = sunny(.3, .01);
  ASSERT_LT(honest.predicted.error(1, 0), kBudget);
  ASSERT_LT(honest.predicted.error(1, 1), honest.predicted.error(1, 0) / 2);
  EXPECT_EQ(honest.min_factor(costs, kBudget), 0);
  EXPECT_EQ(honest.choose(costs, kBudget, 1)->lights, 0) << "the cheapest that is promised to do";
  // Worse than predicted: the factor must drive the choice to the light.
  const ScenePlans worse = sunny(.7, .01);
  const double q = worse.min_factor(costs, kBudget);
  EXPECT_NEAR(q, kBudget / worse.predicted.error(1, 0), 1e-6);
  EXPECT_EQ(worse.choose(costs, kBudget, q)->lights, 1);
  EXPECT_EQ(worse.min_factor(costs, .8), 0) << "within this budget both are";
  EXPECT_FALSE(worse.choose(costs, 1e-4, 1)) << "no plan is that good";
}

}  // namespace
}  // namespace penumbra::tools
