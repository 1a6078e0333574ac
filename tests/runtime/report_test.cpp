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

}  // namespace
}  // namespace penumbra::runtime
