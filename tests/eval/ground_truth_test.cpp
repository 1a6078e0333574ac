// The composite against a world in which the object really stands, under the same truncated light:
// what bake, shadow map, interpolation and composite cost, apart from truncation.
#include <gtest/gtest.h>

#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

struct Case {
  const char* name;
  int bands;
};

class GroundTruth : public testing::TestWithParam<Case> {
 protected:
  static PreparedScene& scene() {
    static PreparedScene prepared = [] {
      return *test::prepared({{test::twist({0, 0, 0})}, {test::grey_plane()}}, 2048);
    }();
    return prepared;
  }
};

TEST_P(GroundTruth, ObjectAndShadowStayWithinOnePercentUnderTheSameTruncatedLight) {
  const Image<Rgb> map = std::string_view(GetParam().name) == "room"
                             ? capture::make_room_environment(256, 128)
                             : capture::make_sky_environment(256, 128, .8);
  const auto projection = lighting::project_latlong(map, kMaxBands);
  ASSERT_TRUE(projection);
  const auto light = lighting::make_estimate(*projection, GetParam().bands);
  const prt::PinholeView view{
      112, 84, {122, 122}, {56, 42}, capture::look_at({.25, .95, 1.35}, {0, .17, 0})};
  const StillScene in{&scene(), &map, view};
  const auto masks = make_masks(scene(), view);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks) << masks.error().detail;
  auto empty = render_real(in, .01, {});
  ASSERT_TRUE(empty);
  light_floor(in, light, *masks, *empty);
  const auto truth = render_reference(in, true, .003, light, {});
  ASSERT_TRUE(truth);
  const auto ours = render_composite(in, light, *empty);
  ASSERT_TRUE(ours);
  const Accuracy a = compare_pictures(*ours, *truth, *empty, *masks);
  std::printf(
      "%s, %d bands: object %.2f %% (reference noise %.2f %%, without it %.2f %%), bias %.2f %%, "
      "shadow %.4f\n",
      GetParam().name, GetParam().bands, 100 * a.object_rel_rmse, 100 * a.reference_error,
      100 * a.object_without_noise, 100 * a.object_bias, a.shadow_rmse);
  EXPECT_LE(a.object_without_noise, .01);
  EXPECT_LE(std::abs(a.object_bias), .01);
  EXPECT_LE(a.shadow_rmse, .01);
}

INSTANTIATE_TEST_SUITE_P(Lights, GroundTruth, testing::Values(Case{"room", 5}, Case{"sky", 2}),
                         [](const auto& c) {
                           return std::string(c.param.name) + std::to_string(c.param.bands);
                         });

}  // namespace
}  // namespace penumbra::tools
