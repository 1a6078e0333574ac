// Virtual things in a virtual mirror: where and how bright the laws of a plane mirror put them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <memory>
#include <string>
#include <utility>
#include <variant>

#include "capture/capture.h"
#include "core/threads/stage_times.h"
#include "lighting/lighting.h"
#include "prt/geometry/material.h"
#include "runtime/shading/composite_stage.h"
#include "tests/support/gl.h"
#include "tests/support/worlds.h"
#include "tools/pictures/still.h"

namespace penumbra::tools {
namespace {

using glm::dvec3;
using runtime::PreparedScene;

constexpr double kMirrorZ = -.25, kBallRadius = .08;
const dvec3 kBall{.15, kBallRadius, .25};
const Rgb kSteel{.55f, .55f, .55f};

void cover(PreparedScene& scene, std::size_t object, const prt::Material& material) {
  prt::SurfaceMaterials surface;
  surface.materials = {material};
  surface.material.assign(scene.objects[object].baked.mesh.positions.size(), 0);
  scene.objects[object].baked.surface =
      std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
}

runtime::SceneObject standing(const char* shape, const dvec3& position, double size_m) {
  runtime::SceneObject o = test::twist(position);
  o.asset = std::string("builtin:") + shape;
  o.name = shape;
  o.fit_size_m = size_m;
  o.coarse = true;
  return o;
}

// A box of steel, its front a mirror, and before it a ball that sends red.
Result<PreparedScene> mirror_and_ball(float roughness) {
  PENUMBRA_ASSIGN(scene, test::prepared({{standing("box", {0, 0, kMirrorZ - .25}, .5),
                                          standing("ball", {kBall.x, 0, kBall.z}, 2 * kBallRadius)},
                                         {test::grey_plane()}},
                                        128));
  cover(scene, 0, {.name = "steel", .base_colour = kSteel, .metallic = 1, .roughness = roughness});
  cover(scene, 1, {.name = "red", .base_colour = {1, 0, 0}, .unlit = true});
  return scene;
}

const prt::PinholeView kView{
    320, 240, {330, 330}, {160, 120}, capture::look_at({-.3, .35, 1.6}, {0, .2, kMirrorZ})};

glm::ivec2 pixel_of(const dvec3& point) {
  const dvec3 p = kView.world_from_camera.inverse() * point;
  return {static_cast<int>(kView.principal_px.x + kView.focal_px.x * p.x / -p.z),
          static_cast<int>(kView.principal_px.y - kView.focal_px.y * p.y / -p.z)};
}

Result<Still> picture_of(const PreparedScene& scene) {
  const Image<Rgb> map(64, 32, {1, 1, 1});
  lighting::LightEstimator estimator({3, {}});
  estimator.mirror(runtime::mirrored_roughness(scene));
  Environment environment;
  environment.radiance = map;
  PENUMBRA_ASSIGN(light, estimator.estimate(environment));
  const StillScene in{&scene, &map, kView};
  Still real;
  real.radiance = Image<Rgb>(320, 240, {.1f, .1f, .1f});
  return render_composite(in, light, real);
}

// (red, green) around the place of a point.
std::pair<double, double> seen_at(const Still& picture, const dvec3& point) {
  const glm::ivec2 at = pixel_of(point);
  double red = 0, green = 0;
  for (int y = at.y - 2; y <= at.y + 2; ++y)
    for (int x = at.x - 2; x <= at.x + 2; ++x)
      red += picture.radiance.at(x, y).r / 25, green += picture.radiance.at(x, y).g / 25;
  return {red, green};
}

class MirroredObjects : public testing::Test {
 protected:
  void SetUp() override {
    PENUMBRA_NEED_GL(
        compositor::Compositor::create(8, 8, compositor::Compositor::Surface::kOffscreen));
  }
};

TEST_F(MirroredObjects, AreSeenBehindThePlaneOfAMirrorAsBrightAsItReflects) {
  const auto scene = mirror_and_ball(.02f);
  ASSERT_TRUE(scene) << scene.error().detail;
  const auto picture = picture_of(*scene);
  ASSERT_TRUE(picture) << picture.error().detail;
  const dvec3 image(kBall.x, kBall.y, 2 * kMirrorZ - kBall.z);
  const auto [direct, none] = seen_at(*picture, kBall);
  const auto [red, green] = seen_at(*picture, image);
  EXPECT_LT(none, .02 * direct);
  EXPECT_NEAR(red / direct, kSteel.r, .03);  // Fresnel's term adds less than .01 here
  EXPECT_LT(green, .02 * red);
  // Beside its image the mirror shows the even surroundings.
  const auto [beside_red, beside_green] =
      seen_at(*picture, image + dvec3(-1.6 * kBallRadius, .3 * kBallRadius, 0));
  EXPECT_NEAR(beside_red, beside_green, .05 * beside_green);
  EXPECT_GT(beside_green, .1 * direct);
}

TEST_F(MirroredObjects, AreBlurredByARoughSurfaceAndLoseNoLight) {
  const auto sharp = mirror_and_ball(.02f), rough = mirror_and_ball(.3f);
  ASSERT_TRUE(sharp && rough);
  const auto a = picture_of(*sharp), b = picture_of(*rough);
  ASSERT_TRUE(a && b);
  // The mirror's front, without the ball before it.
  double of_sharp = 0, of_rough = 0;
  const dvec3 image(kBall.x, kBall.y, 2 * kMirrorZ - kBall.z);
  const glm::ivec2 at = pixel_of(image);
  for (int y = at.y - 40; y <= at.y + 30; ++y)
    for (int x = at.x - 40; x <= at.x + 40; ++x) {
      const auto excess = [](const Rgb& c) { return std::max(c.r - c.g, 0.f); };
      of_sharp += excess(a->radiance.at(x, y)), of_rough += excess(b->radiance.at(x, y));
    }
  const auto [sharp_red, sharp_green] = seen_at(*a, image);
  const auto [rough_red, rough_green] = seen_at(*b, image);
  EXPECT_LT(rough_red - rough_green, .97 * (sharp_red - sharp_green));
  EXPECT_GT(rough_red - rough_green, .3 * (sharp_red - sharp_green));
  EXPECT_NEAR(of_rough / of_sharp, 1, .25);
}

TEST_F(MirroredObjects, AreGoneFromTheMirrorWhenTheyAreMoved) {
  auto scene = mirror_and_ball(.02f);
  ASSERT_TRUE(scene);
  scene->objects[1].world_from_bake.translation.x -= .25;
  const auto picture = picture_of(*scene);
  ASSERT_TRUE(picture);
  const dvec3 image(kBall.x, kBall.y, 2 * kMirrorZ - kBall.z);
  const auto [red, green] = seen_at(*picture, image);
  EXPECT_NEAR(red, green, .05 * green);
  const auto [moved_red, moved_green] = seen_at(*picture, image - dvec3(.25, 0, 0));
  EXPECT_LT(moved_green, .05 * moved_red);
}

// ---- One stage over several frames. ----

class MirroredLive : public MirroredObjects {
 protected:
  static constexpr int kWide = 320, kHigh = 240;

  static capture::CameraInfo camera() {
    capture::CameraInfo out;
    out.name = "view", out.role = capture::Role::kView;
    out.projection = {calib::ProjectionKind::kPinhole, kWide, kHigh, kView.focal_px,
                      kView.principal_px};
    return out;
  }
  static lighting::LightEstimate light_of(const PreparedScene& scene, float brightness) {
    lighting::LightEstimator estimator({3, {}});
    estimator.mirror(runtime::mirrored_roughness(scene));
    Environment environment;
    environment.radiance = Image<Rgb>(64, 32, {brightness, brightness, brightness});
    return *estimator.estimate(environment);
  }
  Result<std::unique_ptr<runtime::CompositeStage>> stage_for(const PreparedScene& scene) {
    return runtime::CompositeStage::create({camera(), camera()}, scene,
                                           compositor::Compositor::Surface::kOffscreen, times_);
  }
  static Image<Rgb> frame(runtime::CompositeStage& stage, const lighting::LightEstimate& light,
                          int number, const Pose& eye = kView.world_from_camera, int camera = 0) {
    capture::Frame frame;
    frame.camera = camera;
    frame.time = {std::int64_t{40'000'000} * number};
    frame.exposure = {Seconds(1), Gain(1)};
    frame.world_from_camera = eye;
    frame.pixels = std::make_shared<const FramePixels>(Image<Rgb>(kWide, kHigh, {.1f, .1f, .1f}));
    const auto out = stage.process(frame, light);
    EXPECT_TRUE(out);
    return out ? std::get<Image<Rgb>>(out->pixels) : Image<Rgb>();
  }
  static double difference(const Image<Rgb>& a, const Image<Rgb>& b) {
    double most = 0;
    for (std::size_t i = 0; i < a.area(); ++i)
      for (int c = 0; c < 3; ++c)
        most = std::max(most, std::abs(double{a.pixels()[i][c]} - b.pixels()[i][c]));
    return most;
  }

  StageTimes times_;
};

TEST_F(MirroredLive, WhatMovesAndHidesChangesInTheMirrorAsInAFreshStage) {
  const auto scene = mirror_and_ball(.02f);
  ASSERT_TRUE(scene);
  const lighting::LightEstimate light = light_of(*scene, 1);
  const auto going = stage_for(*scene), fresh = stage_for(*scene);
  ASSERT_TRUE(going && fresh);
  const Image<Rgb> before = frame(**going, light, 0);
  const runtime::ObjectPlace moved{{kBall.x - .2, 0, kBall.z + .1}, .4};
  for (runtime::CompositeStage* stage : {going->get(), fresh->get()})
    ASSERT_TRUE(stage->moves().put("ball", moved));
  const Image<Rgb> after = frame(**going, light, 1);
  EXPECT_GT(difference(before, after), .2);
  EXPECT_LT(difference(after, frame(**fresh, light, 1)), .01);
  ASSERT_TRUE((*going)->moves().show("ball", false));
  const Image<Rgb> hidden = frame(**going, light, 2);
  const glm::ivec2 image = pixel_of({kBall.x - .2, kBall.y, 2 * kMirrorZ - kBall.z - .1});
  EXPECT_GT(after.at(image.x, image.y).r, 5 * after.at(image.x, image.y).g);
  EXPECT_NEAR(hidden.at(image.x, image.y).r, hidden.at(image.x, image.y).g, .02);
}

TEST_F(MirroredLive, AnotherLightIsSeenInWhatWasMetBefore) {
  auto scene = mirror_and_ball(.02f);
  ASSERT_TRUE(scene);
  cover(*scene, 1, {.name = "matt", .base_colour = {.8f, .1f, .1f}, .roughness = 1});
  const auto stage = stage_for(*scene);
  ASSERT_TRUE(stage);
  const Image<Rgb> one = frame(**stage, light_of(*scene, .4f), 0),
                   two = frame(**stage, light_of(*scene, .8f), 1);
  const glm::ivec2 at = pixel_of({kBall.x, kBall.y, 2 * kMirrorZ - kBall.z});
  EXPECT_GT(one.at(at.x, at.y).r, 2 * one.at(at.x, at.y).g);  // the ball
  EXPECT_NEAR(two.at(at.x, at.y).r / one.at(at.x, at.y).r, 2, .05);
  EXPECT_EQ(difference(two, frame(**stage, light_of(*scene, .8f), 2)), 0);
}

TEST_F(MirroredLive, EachOfTwoCamerasSeesItsOwnReflection) {
  const auto scene = mirror_and_ball(.02f);
  ASSERT_TRUE(scene);
  const lighting::LightEstimate light = light_of(*scene, 1);
  const Pose other = capture::look_at({.1, .45, 1.6}, {0, .2, kMirrorZ});
  const auto both = stage_for(*scene), alone = stage_for(*scene);
  ASSERT_TRUE(both && alone);
  const Image<Rgb> left = frame(**both, light, 0), right = frame(**both, light, 0, other, 1);
  EXPECT_GT(difference(left, right), .2);
  EXPECT_LT(difference(right, frame(**alone, light, 0, other, 1)), .01);
  EXPECT_LT(difference(left, frame(**both, light, 1)), .01);  // and the first one its own again
}

// A rough part beside a smooth one is no mirror.
TEST_F(MirroredLive, RoughPartsStayMatt) {
  auto scene = mirror_and_ball(.9f);
  ASSERT_TRUE(scene);
  auto surface = *scene->objects[0].baked.surface;
  surface.materials.push_back(
      {.name = "mirror", .base_colour = kSteel, .metallic = 1, .roughness = .02f});
  surface.materials[0].metallic = 0;
  const prt::Mesh& mesh = scene->objects[0].baked.mesh;
  for (std::size_t v = 0; v < mesh.positions.size(); ++v)
    if (mesh.normals[v].z < .5f) surface.material[v] = 1;  // all but the front
  scene->objects[0].baked.surface =
      std::make_shared<const prt::SurfaceMaterials>(std::move(surface));
  const auto stage = stage_for(*scene);
  ASSERT_TRUE(stage);
  const Image<Rgb> seen = frame(**stage, light_of(*scene, 1), 0);
  const glm::ivec2 at = pixel_of({kBall.x, kBall.y, 2 * kMirrorZ - kBall.z});
  EXPECT_NEAR(seen.at(at.x, at.y).r / seen.at(at.x, at.y).g, 1, .1);
}

}  // namespace
}  // namespace penumbra::tools
