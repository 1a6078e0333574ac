// What the proof of the governor rests on.
#include "service/governor_bench.h"

#include <gtest/gtest.h>

#include <cmath>

namespace penumbra::service {
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

TEST(ScenePlans, WorstRatioIsTheLargestOfMeasuredToPredicted) {
  ScenePlans plans;
  EXPECT_EQ(plans.worst_ratio(), 0);
  plans.plans = {{1, 0, .2, .1}, {2, 0, .1, .15}, {3, 1, .05, .05}};
  EXPECT_NEAR(plans.worst_ratio(), 1.5, 1e-12);
}

}  // namespace
}  // namespace penumbra::service
