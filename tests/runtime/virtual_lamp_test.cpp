// A virtual lamp through the whole pipeline: the real floor brightens by the same ratio as shadows
// darken it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/gltf_assets.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/pictures/still.h"

namespace penumbra::runtime {

using namespace tools;
namespace {

PreparedScene lamp_scene(bool with_lamp, bool with_object) {
  PreparedScene scene;
  scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.4f, .4f, .4f}, {}});
  prt::Mesh mesh = with_object
                       ? prt::make_box({-.1f, 0, -.1f}, {.1f, .2f, .1f}, 4, {.6f, .6f, .6f})
                       : prt::make_box({-9.1f, 0, -9.1f}, {-9, .1f, -9}, 2, {.6f, .6f, .6f});
  prt::BakeOptions bake;
  bake.rays = bake.ground_rays = 64;
  bake.bounces = 1;
  bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
  scene.objects.push_back({"box", *prt::bake(std::move(mesh), bake), {}, 0, nullptr});
  if (with_lamp) scene.lamps.push_back({{.4, .6, 0}, .02, {2, 1, .5f}});
  return scene;
}

TEST(VirtualLamp, LightsTheFloorByItsShareOfTheRealLightAndCastsShadows) {
  const prt::PinholeView view{
      160, 120, {150, 150}, {80, 60}, capture::look_at({0, 1.6, 1.2}, {0, 0, 0})};
  lighting::LightEstimate light;
  light.valid = true;
  light.light = RadianceSh(5);
  light.light[0] = Rgb{1, 1, 1} * static_cast<float>(std::sqrt(4 * kPi));  // radiance 1, E = pi
  light.upper_hemisphere_light = light.light;
  light.mean_radiance = {1, 1, 1};
  Still real;
  real.radiance = Image<Rgb>(160, 120, {.4f, .4f, .4f});
  const auto shown = [&](bool lamp, bool object) {
    const PreparedScene scene = lamp_scene(lamp, object);
    return render_composite({&scene, nullptr, view}, light, real);
  };
  const auto open = shown(true, false), with = shown(true, true), without = shown(false, true);
  if (!open && open.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << open.error().detail;
  ASSERT_TRUE(open && with && without);
  const auto pixel = [&](const glm::dvec3& p) {
    const glm::dvec3 c = view.world_from_camera.inverse() * p;
    return glm::ivec2(static_cast<int>(view.principal_px.x + view.focal_px.x * c.x / -c.z),
                      static_cast<int>(view.principal_px.y - view.focal_px.y * c.y / -c.z));
  };
  const auto floor_at = [&](const glm::ivec2& at) {  // the centre of that pixel on the floor
    const glm::dvec3 d = view.world_from_camera.rotation *
                         glm::dvec3((at.x + .5 - 80) / 150, -(at.y + .5 - 60) / 150, -1);
    const glm::dvec3 eye = view.world_from_camera.translation;
    return eye - d * (eye.y / d.y);
  };
  for (const glm::dvec3 p : {glm::dvec3(.4, 0, 0), {0, 0, .3}, {-.3, 0, -.3}, {.2, 0, .5}}) {
    const glm::ivec2 at = pixel(p);
    const glm::dvec3 to = glm::dvec3(.4, .6, 0) - floor_at(at);
    const double e = .6 / std::pow(glm::length(to), 3);
    const Rgb ratio = open->radiance.at(at.x, at.y) * (1 / .4f);
    EXPECT_NEAR(ratio.r, 1 + 2 * e / kPi, .01 * (1 + 2 * e / kPi)) << at.x << ' ' << at.y;
    EXPECT_NEAR(ratio.b, 1 + .5 * e / kPi, .01 * (1 + .5 * e / kPi));
  }
  const glm::ivec2 shade = pixel({-.2, 0, 0});  // behind the box, seen from the lamp
  EXPECT_NEAR(with->radiance.at(shade.x, shade.y).r, without->radiance.at(shade.x, shade.y).r,
              2e-3);
  const glm::ivec2 lid = pixel({.05, .2, 0});
  EXPECT_GT(with->radiance.at(lid.x, lid.y).r, without->radiance.at(lid.x, lid.y).r + .2f);
}

// Of luminance, over the truth's mean.
double relative_rms(const Still& a, const Still& truth, const std::vector<bool>& where) {
  double square = 0, mean = 0;
  for (std::size_t i = 0; i < where.size(); ++i) {
    if (!where[i]) continue;
    const double d = luminance(a.radiance.pixels()[i]) - luminance(truth.radiance.pixels()[i]);
    square += d * d, mean += luminance(truth.radiance.pixels()[i]);
  }
  const auto count = static_cast<double>(std::ranges::count(where, true));
  return std::sqrt(square / count) / (mean / count);
}

// A scene as it really is, as it is composited, and without its lights of its own.
struct BesideTheTruth {
  Still truth, ours, naive;
};
std::optional<BesideTheTruth> beside_the_truth(const StillScene& in, const PreparedScene& unlit) {
  const auto empty = render_real(in, .01, {}),
             truth = render_reference(in, true, .006, std::nullopt, {});
  const auto light = lighting::estimate_map(*in.environment, {});
  if (!empty || !truth || !light) return std::nullopt;
  const auto ours = render_composite(in, *light, *empty),
             naive = render_composite({&unlit, in.environment, in.view}, *light, *empty);
  if (!ours || !naive) return std::nullopt;
  return BesideTheTruth{*truth, *ours, *naive};
}

// A world in which the lamp really hangs beside the object, low over a dim floor so that it is most
// of the light.
TEST(VirtualLamp, CompositeFollowsTheWorldWithTheLampInIt) {
  Scene world{{test::twist({0, 0, 0})}, {test::grey_plane()}};
  world.lamps.push_back({{.45, .55, .3}, .04, {60, 50, 35}});
  const auto scene = test::prepared(world);
  world.lamps.clear();
  const auto unlit = test::prepared(world);
  ASSERT_TRUE(scene && unlit);
  const Image<Rgb> map = capture::make_room_environment(256, 128);
  const prt::PinholeView view{
      128, 96, {120, 120}, {64, 48}, capture::look_at({.5, 1.2, 1.5}, {0, .15, 0})};
  const StillScene in{&*scene, &map, view};
  const auto masks = make_masks(*unlit, view);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks);
  const auto shown = beside_the_truth(in, *unlit);
  ASSERT_TRUE(shown);
  const auto& [truth, ours, naive] = *shown;
  std::printf("lamp: floor %.3f (without %.3f), object %.2f %% (without %.2f %%)\n",
              relative_rms(ours, truth, masks->floor), relative_rms(naive, truth, masks->floor),
              100 * relative_rms(ours, truth, masks->object),
              100 * relative_rms(naive, truth, masks->object));
  EXPECT_LT(relative_rms(ours, truth, masks->floor), .03);
  EXPECT_GT(relative_rms(naive, truth, masks->floor), .2);
  EXPECT_LT(relative_rms(ours, truth, masks->object), .05);
  EXPECT_GT(relative_rms(naive, truth, masks->object), .2);
}

// A sign that shines, with the light that it throws on the floor and on what stands beside it.
TEST(VirtualLamp, CompositeFollowsTheWorldWithALuminousObjectInIt) {
  const test::TempFolder folder;
  const auto file = folder.path() / "sign.glb";
  test::emissive_sign().write_glb(file);
  Scene world{{test::twist({.5, 0, -.25})}, {test::grey_plane()}};
  SceneObject sign;
  sign.name = "sign";
  sign.asset = file.string();
  sign.place_on_floor = true;
  world.objects.push_back(sign);
  const auto without = test::prepared(world),
             beside = test::prepared({{world.objects[0]}, world.real});
  world.objects.back().emission_lights = true;
  const auto scene = test::prepared(world);
  ASSERT_TRUE(without && beside && scene);
  EXPECT_TRUE(without->objects.back().luminous.empty());
  ASSERT_EQ(scene->objects.back().luminous.size(), 1u);
  const Image<Rgb> map = capture::make_room_environment(256, 128);
  const prt::PinholeView view{
      128, 96, {120, 120}, {64, 48}, capture::look_at({.3, 1.1, 1.4}, {.1, .1, .15})};
  const StillScene in{&*scene, &map, view};
  const auto masks = make_masks(*scene, view), of_twist = make_masks(*beside, view);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks && of_twist);
  const auto shown = beside_the_truth(in, *without);
  ASSERT_TRUE(shown);
  const auto& [truth, ours, naive] = *shown;
  std::printf("sign: floor %.3f (without %.3f), the twist beside it %.2f %% (without %.2f %%)\n",
              relative_rms(ours, truth, masks->floor), relative_rms(naive, truth, masks->floor),
              100 * relative_rms(ours, truth, of_twist->object),
              100 * relative_rms(naive, truth, of_twist->object));
  EXPECT_LT(relative_rms(ours, truth, masks->floor), .015);
  EXPECT_GT(relative_rms(naive, truth, masks->floor), .03);
  EXPECT_LT(relative_rms(ours, truth, of_twist->object), .04);
  EXPECT_GT(relative_rms(naive, truth, of_twist->object), .05);
}

// Of more luminous things than are traced the strongest light, of equal ones as many as may.
TEST(VirtualLamp, OfManyLuminousThingsSixteenLight) {
  const test::TempFolder folder;
  const auto file = folder.path() / "sign.glb";
  test::emissive_sign().write_glb(file);
  Scene world{{}, {test::grey_plane()}};
  for (int i = 0; i < 18; ++i) {
    SceneObject sign;
    sign.name = "sign " + std::to_string(i);
    sign.asset = file.string();
    sign.position = {i, 0, 0};
    sign.coarse = true;
    sign.emission_lights = true;
    world.objects.push_back(sign);
  }
  const auto scene = test::prepared(world);
  ASSERT_TRUE(scene);
  std::size_t parts = 0;
  for (const PreparedObject& o : scene->objects) parts += o.luminous.size();
  EXPECT_EQ(parts, 16u);
}

// A lamp among real things and nothing virtual that could cast a shadow: no light comes from the
// real mesh, and nothing stops.
TEST(VirtualLamp, WithoutAnObjectARealMeshIsNoReasonToStop) {
  Scene scene;
  RealGeometry box;
  box.mesh = "builtin:box";
  scene.real.push_back(box);
  scene.lamps.push_back({{.4, .6, 0}, .02, {2, 1, .5f}});
  const auto prepared =
      prepare(scene, {}, [](const std::string&) { return std::function<void(double)>(); });
  ASSERT_TRUE(prepared) << prepared.error().detail;
  const prt::PinholeView view{
      160, 120, {150, 150}, {80, 60}, capture::look_at({0, 1.6, 1.2}, {0, 0, 0})};
  lighting::LightEstimate light;
  light.valid = true;
  light.light = RadianceSh(5);
  light.light[0] = {1, 1, 1};
  light.upper_hemisphere_light = light.light;
  light.mean_radiance = {1, 1, 1};
  Still real;
  real.radiance = Image<Rgb>(160, 120, {.4f, .4f, .4f});
  const auto shown = render_composite({&*prepared, nullptr, view}, light, real);
  if (!shown && shown.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << shown.error().detail;
  ASSERT_TRUE(shown) << shown.error().detail;
  EXPECT_TRUE(
      std::ranges::all_of(shown->radiance.pixels(), [](const Rgb& c) { return is_finite(c); }));
}

}  // namespace
}  // namespace penumbra::runtime
