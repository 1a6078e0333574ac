// What the program takes by itself at its default budget, whole light on both sides, held against a world in which the object
// really stands; beside it what others would show.
#include <gtest/gtest.h>

#include "service/baselines.h"
#include "service/chart_bench.h"
#include "service/governor_bench.h"
#include "service/light_file.h"
#include "tests/support/shared_data.h"

namespace penumbra::service {
namespace {

std::optional<Image<Rgb>> map_of(const std::string& name) {
  if (name == "room") return capture::make_room_environment(1024, 512);
  if (name == "clear_sky") return capture::make_sky_environment(1024, 512, .8);
  const auto path = test::shared_data("envmaps/" + name + "_1k.hdr");
  if (!path) return std::nullopt;
  auto light = read_light(path->string(), std::nullopt);
  if (!light) return std::nullopt;
  auto map = capture::to_latlong(light->file);
  return map ? std::optional(std::move(*map)) : std::nullopt;
}

// One bake for all: tests of one program run after each other.
const Result<ChartScene>& bench() {
  static const Result<ChartScene> scene = ChartScene::make("builtin:twist", 1024);
  return scene;
}

class DefaultBudget : public testing::TestWithParam<const char*> {};

TEST_P(DefaultBudget, IsKeptWhereNineCoefficientsAndOneHardLightMissIt) {
  const auto map = map_of(GetParam());
  if (!map)
    GTEST_SKIP() << "shared data file absent: envmaps/" << GetParam() << "_1k.hdr"
                 << " (set PENUMBRA_SHARED_DATA to the folder that holds it)";
  if (!bench() && bench().error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << bench().error().detail;
  ASSERT_TRUE(bench()) << bench().error().detail;
  const ChartScene& scene = *bench();
  const auto truth = trace_truth(scene, *map, .012);
  const auto plan = default_plan(scene, *map, {});
  ASSERT_TRUE(truth && plan);
  const auto measured = [&](const lighting::LightEstimate& light, int bands, const DiscTaps& taps) {
    const auto m = measure(scene, scene.prepared_with(bands), light, taps, *truth);
    EXPECT_TRUE(m);
    return m ? m->accuracy : Accuracy{};
  };
  const auto light = lighting::estimate_map(*map, {plan->bands, {plan->discs, .02}});
  ASSERT_TRUE(light);
  const Accuracy ours = measured(*light, plan->bands, {}),
                 nine = measured(dissertation_light(*map), 3, {}),
                 hard = measured(phone_light(*map), 1, {1, {1, 256}});
  std::printf(
      "%s, %d bands and %d discs: object %.2f %%, bias %.2f %%, shadow %.4f; nine "
      "coefficients %.1f %%, %.4f; ambient and one hard light %.1f %%, %.4f\n",
      GetParam(), plan->bands, plan->discs, 100 * ours.object_without_noise, 100 * ours.object_bias,
      ours.shadow_rmse, 100 * nine.object_without_noise, nine.shadow_rmse,
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
}  // namespace penumbra::service
