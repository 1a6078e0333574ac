// From both cameras' sensors to the picture, against a path-traced world with the object in it.
#include "tools/chart/benches/through_sensor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "capture/studio/environments.h"
#include "capture/studio/world.h"
#include "core/conventions.h"

namespace penumbra::tools {
namespace {

constexpr double kReferenceError = .05;  // its noise is taken out by its two halves
constexpr SensorSettings kWebcam{8, Seconds(1e-3)};

SensorScene box_on_floor() {
  const std::vector<std::string> assets{"builtin:box"};
  return sensor_scenes(assets)[0];
}

// As bright as the studio's cameras are made for.
Image<Rgb> sky() {
  return (*capture::FloorWorld::make(capture::make_sky_environment(1024, 512, .8)))->environment();
}
Image<Rgb> room() {
  return (*capture::FloorWorld::make(capture::make_room_environment(1024, 512)))->environment();
}

Result<SensorPoint> filmed(const SensorScene& scene, const Image<Rgb>& map,
                           const SensorSettings& settings, SensorLens lens = SensorLens::kPinhole) {
  PENUMBRA_ASSIGN(bench, SensorBench::make(scene, lens));
  PENUMBRA_ASSIGN(world, bench.trace("world", map, kReferenceError));
  return bench.measure(world, settings);
}

#define ASSERT_FILMED(point)                                                     \
  if (!point && point.error().code == ErrorCode::kUnavailable)                   \
    GTEST_SKIP() << "no OpenGL ES 3.1 or Embree here: " << point.error().detail; \
  ASSERT_TRUE(point) << point.error().where << ": " << point.error().detail

TEST(ThroughSensor, ARoomLooksAsUnderItsTrueMap) {
  const auto bench = SensorBench::make(box_on_floor(), SensorLens::kPinhole);
  ASSERT_FILMED(bench);
  const Image<Rgb> map = room();  // the world points to it
  const auto world = bench->trace("world", map, kReferenceError);
  ASSERT_FILMED(world);
  for (const int bits : {8, 12}) {
    const auto got = bench->measure(*world, {bits, Seconds(1. / 64000)});
    ASSERT_FILMED(got);
    EXPECT_FALSE(got->lower_bound);
    EXPECT_LT(got->sensor.shadow_rmse, .04) << bits << " bits";
    EXPECT_LT(got->sensor.shadow_rmse - got->true_map.shadow_rmse, .003) << bits << " bits";
    EXPECT_LT(got->sensor.object_rel_rmse, .04) << bits << " bits";
    EXPECT_LT(std::abs(got->sensor.object_bias - got->true_map.object_bias), .01) << bits;
  }
}

// At 1/1000 s the sun is ten thousand times too bright.
TEST(ThroughSensor, ASunThatSaturatesEveryExposureCastsItsWholeShadow) {
  const auto got = filmed(box_on_floor(), sky(), kWebcam);
  ASSERT_FILMED(got);
  EXPECT_FALSE(got->lower_bound);
  EXPECT_LT(got->sensor.shadow_rmse, .04);
  EXPECT_LT(got->sensor.shadow_rmse - got->true_map.shadow_rmse, .015);
  EXPECT_LT(got->sensor.object_rel_rmse, .04);
}

// In the view camera's own bent pixels, where the sun is recovered from its floor, too.
TEST(ThroughSensor, ThroughALensItIsAsInTheWorld) {
  for (const SensorLens lens : {SensorLens::kBarrel, SensorLens::kFisheye}) {
    const auto got = filmed(box_on_floor(), sky(), kWebcam, lens);
    ASSERT_FILMED(got);
    const std::string_view name = kSensorLensNames[static_cast<std::size_t>(lens)];
    EXPECT_FALSE(got->lower_bound) << name;
    EXPECT_LT(got->sensor.shadow_rmse, .04) << name;
    EXPECT_LT(got->sensor.shadow_rmse - got->true_map.shadow_rmse, .015) << name;
    EXPECT_LT(got->sensor.object_rel_rmse, .04) << name;
  }
}

// Real things beside the object: in the shade of a wall all light comes from around, on a block the
// object's light falls on a real mesh.
TEST(ThroughSensor, BesideRealThingsItIsAsInTheWorld) {
  const std::vector<std::string> assets{"builtin:box"};
  int scenes = 0;
  for (const SensorScene& scene : sensor_scenes(assets)) {
    if (scene.scene.real.size() < 2) continue;
    ++scenes;
    const auto got = filmed(scene, sky(), {8, Seconds(1. / 64000)});
    ASSERT_FILMED(got);
    EXPECT_LT(got->sensor.shadow_rmse, .035) << scene.name;
    EXPECT_LT(got->sensor.object_rel_rmse, .05) << scene.name;
    EXPECT_LT(std::abs(got->sensor.object_bias), .03) << scene.name;
    EXPECT_EQ(got->bands, 5) << scene.name << ": in the shade all light is in the harmonics";
  }
  EXPECT_EQ(scenes, 2);
}

// Pixels that the composite changed by more than 6 % where the truth changed by less than 3.
int changed_for_nothing(const Image<Rgb>& strip) {
  const int width = strip.width() / 3;
  int count = 0;
  for (int y = 0; y < strip.height(); ++y)
    for (int x = 0; x < width; ++x) {
      const auto at = [&](int panel) { return luminance(strip.at(panel * width + x, y)); };
      const float camera = at(0), ours = at(1), truth = at(2);
      count += std::abs(truth - camera) < .03f * camera && std::abs(ours - camera) > .06f * camera;
    }
  return count;
}

// A light object in the sun lights the floor, but not through the block that it stands on, in whose
// shade that would show.
TEST(ThroughSensor, OnABlockNothingShinesThroughIt) {
  const std::vector<std::string> assets{"builtin:ball"};
  const std::vector<SensorScene> scenes = sensor_scenes(assets);
  const auto scene = std::ranges::find(scenes, "on a block", &SensorScene::name);
  ASSERT_NE(scene, scenes.end());
  SensorScene bright = *scene;
  bright.scene.objects[0].albedo = {.9f, .9f, .9f};
  const auto got = filmed(bright, sky(), {8, Seconds(1. / 64000)});
  ASSERT_FILMED(got);
  const int pixels = changed_for_nothing(got->strip);
  std::printf("on a block: %d pixels changed for nothing\n", pixels);
  EXPECT_LT(pixels, 30);
  EXPECT_LT(got->sensor.object_rel_rmse, .04) << "it is drawn";
  EXPECT_LT(got->sensor.shadow_rmse, .05) << "and its shadow";
}

// A bare sun behind the wall: what lights the object comes off the sunlit floor beyond the wall's
// shadow, and off the object itself. (A part of what the bake reflects is 6.4 % off; and where the
// object reflects onto the floor what reaches it past the wall alone, the shadow is .032 off.)
TEST(ThroughSensor, InAWallsShadeAnObjectIsLitByTheFarFloor) {
  const std::vector<std::string> assets{"builtin:knot"};
  const std::vector<SensorScene> scenes = sensor_scenes(assets);
  const auto scene = std::ranges::find(scenes, "before a wall", &SensorScene::name);
  ASSERT_NE(scene, scenes.end());
  const glm::dvec3 sun = glm::normalize(glm::dvec3(.35, .5, -.8));
  Image<Rgb> map(1024, 512);
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const glm::dvec3 d = latlong_direction(x + .5, y + .5, map.width(), map.height());
      map.at(x, y) = glm::dot(d, sun) > std::cos(.009) ? Rgb{2e5f, 2e5f, 2e5f} : Rgb{1, 1, 1};
    }
  const auto got = filmed(*scene, map, {8, Seconds(1. / 64000)});
  ASSERT_FILMED(got);
  const SensorError& error = got->true_map;
  std::printf("in a wall's shade: object %.4f, bias %+.4f, shadow %.4f\n", error.object_rel_rmse,
              error.object_bias, error.shadow_rmse);
  EXPECT_LT(error.object_rel_rmse, .032);
  EXPECT_LT(std::abs(error.object_bias), .02);
  EXPECT_LT(error.shadow_rmse, .029);
}

// A wall that is given as a plane hides half of the sky from the floor, and lights floor and
// object. (With the open floor's light there, the object is .08 to .13 too bright and its shadow
// .07 too faint.)
TEST(ThroughSensor, BeforeAWallThatIsAPlaneItIsAsInTheWorld) {
  for (const char* asset : {"builtin:box", "builtin:knot"}) {
    const std::vector<std::string> assets{asset};
    SensorScene scene = sensor_scenes(assets)[0];
    runtime::RealGeometry wall;
    wall.plane = {{0, 0, -.6}, {0, 0, 1}};
    wall.albedo = {.7f, .6f, .4f};
    scene.scene.real.push_back(wall);
    for (const Image<Rgb>& map : {Image<Rgb>(1024, 512, {1, 1, 1}), sky()}) {
      const auto got = filmed(scene, map, {8, Seconds(1. / 64000)});
      ASSERT_FILMED(got);
      EXPECT_LT(got->sensor.object_rel_rmse, .03) << asset;
      EXPECT_LT(std::abs(got->sensor.object_bias), .025) << asset;
      // Most of it on the wall, where the sky's shadow of the object is left out.
      EXPECT_LT(got->sensor.shadow_rmse, .085) << asset;
    }
  }
}

// The floor that tells a saturated sun's power has the wall's light, too, and not that behind it.
TEST(ThroughSensor, BeforeAPlaneTheSunIsRecoveredToo) {
  const std::vector<std::string> assets{"builtin:box"};
  SensorScene scene = sensor_scenes(assets)[0];
  runtime::RealGeometry wall;
  wall.plane = {{0, 0, -.6}, {0, 0, 1}};
  wall.albedo = {.5f, .5f, .5f};
  scene.scene.real.push_back(wall);
  const auto got = filmed(scene, sky(), kWebcam);
  ASSERT_FILMED(got);
  EXPECT_FALSE(got->lower_bound);
  EXPECT_LT(got->sensor.shadow_rmse - got->true_map.shadow_rmse, .015);
  EXPECT_LT(std::abs(got->sensor.object_bias - got->true_map.object_bias), .02);
}

// What the program would show without the recovery.
TEST(ThroughSensor, OverAFloorOfUnknownAlbedoTheSunsShadowIsFaintAndNothingIsPromised) {
  SensorScene scene = box_on_floor();
  scene.told = scene.scene;
  scene.told->real[0].albedo.reset();
  const auto got = filmed(scene, sky(), kWebcam);
  ASSERT_FILMED(got);
  EXPECT_TRUE(got->lower_bound);
  EXPECT_FALSE(got->predicted_error);
  EXPECT_GT(got->sensor.shadow_rmse, .1);
  EXPECT_LT(got->true_map.shadow_rmse, .04);
}

}  // namespace
}  // namespace penumbra::tools
