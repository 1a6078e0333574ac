// An object that is lifted off its floor or leans, which its bake does not know, against a world in
// which it really is there, and against a bake of it there.
#include <gtest/gtest.h>

#include <cstdio>

#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/mesh_files.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

constexpr int kMapRows = 256;

struct LiftedCase {
  const char* name;
  ObjectPlace place;
  Image<Rgb> (*map)();
  // Of the picture, over those of a bake at that place
  double more_shadow, more_object;
};
void PrintTo(const LiftedCase& c, std::ostream* out) {
  *out << c.name;
}

Image<Rgb> sky_map() {
  return capture::make_sky_environment(2 * kMapRows, kMapRows, .8);
}
Image<Rgb> room_map() {
  return capture::make_room_environment(2 * kMapRows, kMapRows);
}

class ObjectOffItsFloor : public testing::TestWithParam<LiftedCase> {};

TEST_P(ObjectOffItsFloor, LooksAsIfItWereBakedThere) {
  const LiftedCase& c = GetParam();
  const test::TempFolder folder;
  const auto standing = test::prepared({{test::twist({0, 0, 0})}, {test::grey_plane()}});
  ASSERT_TRUE(standing) << standing.error().detail;
  const prt::PinholeView view{
      112, 84, {105, 105}, {56, 42}, capture::look_at({.5, 1.2, 1.5}, {0, .25, 0})};
  auto lifted = make_still_pipeline(*standing, view, {});
  if (!lifted && lifted.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << lifted.error().detail;
  ASSERT_TRUE(lifted);
  ASSERT_TRUE(lifted->move_object("twist", c.place));
  // The same mesh as it lies there.
  const PreparedObject& o = standing->objects[0];
  test::write_obj(o.baked.mesh, folder.path() / "twist.obj");
  const Pose there = lifted->objects()[0].world_from_bake;
  SceneObject in_place;
  in_place.name = "there";
  in_place.asset = (folder.path() / "twist.obj").string();
  in_place.albedo = {.6f, .6f, .6f};
  in_place.position = there.translation;
  in_place.rotation = there.rotation;
  const auto scene = test::prepared({{in_place}, {test::grey_plane()}});
  ASSERT_TRUE(scene) << scene.error().detail;
  auto baked = make_still_pipeline(*scene, view, {});
  const auto masks = make_masks(*scene, view);
  ASSERT_TRUE(baked && masks);

  const Image<Rgb> map = c.map();
  Environment environment;
  environment.radiance = map;
  lighting::LightEstimator estimator({5, {}});
  const auto light = estimator.estimate(environment);
  ASSERT_TRUE(light);
  const StillScene in{&*scene, &map, view};
  const auto empty = render_real(in, .008, {});
  const auto truth = render_reference(in, true, .008, std::nullopt, {});
  ASSERT_TRUE(empty && truth);
  const auto measure = [&](Pipeline& pipeline) {
    for (int i = 0; i < 2; ++i) EXPECT_TRUE(composite_still(pipeline, view, *light, *empty));
    const auto ours = composite_still(pipeline, view, *light, *empty);
    EXPECT_TRUE(ours);
    return compare_pictures(*ours, *truth, *empty, *masks);
  };
  const Accuracy live = measure(*lifted), rebaked = measure(*baked);
  std::printf(
      "%s: shadow %.4f (baked there %.4f), object %.2f %% (%.2f %%), bias %.2f %% (%.2f %%)\n",
      c.name, live.shadow_rmse, rebaked.shadow_rmse, 100 * live.object_without_noise,
      100 * rebaked.object_without_noise, 100 * live.object_bias, 100 * rebaked.object_bias);
  EXPECT_LT(live.shadow_rmse, rebaked.shadow_rmse + c.more_shadow);
  EXPECT_LT(live.object_without_noise, rebaked.object_without_noise + c.more_object);
}

const LiftedCase kCases[] = {
    {"just_off_the_floor", {{0, .02, 0}, 0}, room_map, .002, .015},
    // With the bake's transfer turned along: .012 and 4 %.
    {"lifted_under_a_sun", {{0, .15, 0}, .3}, sky_map, .002, .01},
    {"leaning", {{0, 0, 0}, 0, .6, .4}, room_map, .002, .015},
    {"leaning_under_a_sun", {{0, 0, 0}, 0, .6, .4}, sky_map, .003, .02},
    {"lying_on_its_side", {{0, 0, 0}, 0, kPi / 2, 2}, room_map, .003, .015},
    {"upside_down_in_the_air", {{0, .2, 0}, 0, kPi, 1}, room_map, .002, .01},
};

INSTANTIATE_TEST_SUITE_P(Places, ObjectOffItsFloor, testing::ValuesIn(kCases),
                         [](const auto& test) { return std::string(test.param.name); });

}  // namespace
}  // namespace penumbra::tools
