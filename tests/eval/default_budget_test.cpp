// What the program takes by itself at its default budget, whole light on both sides, held against a
// world in which the object really stands; beside it what others would show.
#include <gtest/gtest.h>

#include "lighting/lighting.h"
#include "tests/support/environment_maps.h"
#include "tools/chart/benches/chart_bench.h"
#include "tools/chart/governor/governor_bench.h"
#include "tools/chart/peers/baselines.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

// One bake for all: tests of one program run after each other.
const Result<ChartScene>& bench() {
  static const Result<ChartScene> scene = ChartScene::make("builtin:twist", 1024);
  return scene;
}

class DefaultBudget : public testing::TestWithParam<const char*> {};

TEST_P(DefaultBudget, IsKeptWhereNineCoefficientsAndOneHardLightMissIt) {
  PENUMBRA_NEED_ENVIRONMENT(map, GetParam());
  if (!bench() && bench().error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << bench().error().detail;
  ASSERT_TRUE(bench()) << bench().error().detail;
  const ChartScene& scene = *bench();
  const auto truth = trace_truth(scene, map, .012);
  const auto plan = default_plan(scene, map, {});
  ASSERT_TRUE(truth && plan);
  const auto measured = [&](const lighting::LightEstimate& light, int bands,
                            const ShadowSampling& sampling) {
    const auto m = measure(scene, scene.prepared_with(bands), light, sampling, *truth);
    EXPECT_TRUE(m);
    return m ? m->accuracy : Accuracy{};
  };
  const auto light = lighting::estimate_map(map, {plan->bands, {plan->lights, .02}});
  ASSERT_TRUE(light);
  const Accuracy ours = measured(*light, plan->bands, {}),
                 nine = measured(dissertation_light(map), 3, {}),
                 hard = measured(phone_light(map), 1, {1, {1, 256}});
  std::printf(
      "%s, %d bands and %d lights: object %.2f %%, bias %.2f %%, shadow %.4f; nine "
      "coefficients %.1f %%, %.4f; ambient and one hard light %.1f %%, %.4f\n",
      GetParam(), plan->bands, plan->lights, 100 * ours.object_without_noise,
      100 * ours.object_bias, ours.shadow_rmse, 100 * nine.object_without_noise, nine.shadow_rmse,
      100 * hard.object_without_noise, hard.shadow_rmse);
  EXPECT_LE(ours.object_without_noise, .03);
  EXPECT_LE(std::abs(ours.object_bias), .01);
  EXPECT_LE(ours.shadow_rmse, .05);
  EXPECT_GT(nine.shadow_rmse, .05) << "nine coefficients would do";
  EXPECT_GT(hard.shadow_rmse, .05) << "one hard light would do";
  EXPECT_GT(nine.object_without_noise, .03);
  EXPECT_GT(hard.object_without_noise, 2 * ours.object_without_noise);
}

INSTANTIATE_TEST_SUITE_P(Environments, DefaultBudget,
                         testing::Values("room", "clear_sky", "rustig_koppie_puresky",
                                         "studio_small_03"),
                         [](const auto& p) { return std::string(p.param); });

}  // namespace
}  // namespace penumbra::tools
