#include "runtime/pipeline/report.h"
#include "lighting/lighting.h"

#include <gtest/gtest.h>

#include <string>

namespace penumbra::runtime {
namespace {

TEST(Report, APlanSaysWhyItWasTaken) {
  const auto why = [](bool within_budget, bool time_limited) {
    lighting::Plan plan;
    plan.bands = 5, plan.lights = 1, plan.error = .03;
    plan.within_budget = within_budget, plan.time_limited = time_limited;
    const nlohmann::json said = to_json(plan);
    EXPECT_EQ(said["bands"], 5);
    EXPECT_EQ(said["lights"], 1);
    EXPECT_EQ(said["predicted_error"], .03);
    return said["why"].get<std::string>();
  };
  EXPECT_NE(why(true, false).find("cheapest"), std::string::npos);
  EXPECT_NE(why(false, true).find("time"), std::string::npos);
  EXPECT_NE(why(false, false).find("none is within the limit"), std::string::npos);
}

TEST(Report, WhatNoCameraSeesIsTheReason) {
  lighting::Plan plan;
  plan.error = .2, plan.unseen = true, plan.within_budget = false;
  EXPECT_NE(to_json(plan)["why"].get<std::string>().find("no camera sees"), std::string::npos);
}

TEST(Report, NoErrorIsPromisedOverALowerBound) {
  lighting::Plan plan;
  plan.error = .03, plan.lower_bound = true, plan.within_budget = false;
  const nlohmann::json said = to_json(plan);
  EXPECT_TRUE(said["predicted_error"].is_null());
  EXPECT_EQ(said["lower_bound"], true);
  EXPECT_EQ(said["within_budget"], false);
  EXPECT_NE(said["why"].get<std::string>().find("at least"), std::string::npos);
}

}  // namespace
}  // namespace penumbra::runtime
