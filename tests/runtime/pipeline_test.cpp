#include "runtime/pipeline/pipeline.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calib/calib.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/gl.h"

namespace penumbra {
namespace {

// A small studio and a sphere that is not real.
struct Bench {
  std::shared_ptr<capture::FloorWorld> world =
      *capture::FloorWorld::make(capture::make_room_environment(128, 64));
  capture::StudioOptions options;
  std::shared_ptr<runtime::PreparedScene> scene = std::make_shared<runtime::PreparedScene>();

  Bench() {
    prt::Mesh mesh = prt::make_sphere({0, .2f, 0}, .2f, 3, {.5f, .5f, .5f});
    prt::BakeOptions bake;
    bake.rays = bake.ground_rays = 64;
    bake.bounces = 1;
    bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
    scene->objects.push_back({"sphere", *prt::bake(std::move(mesh), bake), {}, 0});
    options.environment_width = 128;
    options.environment_height = 64;
    options.view_width = 96;
    options.view_height = 64;
    options.view_focal_px = 80;
    options.view_frames = 6;
    options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
    options.sensor.response = calib::Response::srgb();
  }
};

const Bench& bench() {
  static const Bench b;
  return b;
}

std::vector<capture::CameraInfo> view_camera_alone() {
  std::vector<capture::CameraInfo> cameras =
      capture::Studio(bench().world, bench().options).cameras();
  std::erase_if(cameras, [](const auto& c) { return c.role != capture::Role::kView; });
  return cameras;
}

capture::Frame view_frame() {
  capture::Studio studio(bench().world, bench().options);
  while (true) {
    auto frame = *studio.next();
    if (studio.cameras()[static_cast<std::size_t>(frame->camera)].role == capture::Role::kView)
      return std::move(*frame);
  }
}

// A recording does not know when it was filmed.
TEST(Pipeline, AReplayOfASunNeedsItsTime) {
  capture::Studio studio(bench().world, bench().options);
  auto scene = std::make_shared<runtime::PreparedScene>(*bench().scene);
  scene->sun = lighting::SunSite{50, 8, 0, {}};
  const auto sink = [](const runtime::Output&) { return true; };
  auto pipeline = Pipeline::create(studio.cameras(), scene);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline);
  const auto refused = pipeline->replay(studio, sink);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().where, "sun");
  scene->sun->time = std::chrono::sys_days{std::chrono::year(2026) / 6 / 21};
  auto told = Pipeline::create(studio.cameras(), scene);
  ASSERT_TRUE(told);
  EXPECT_TRUE(told->replay(studio, sink));
}

TEST(Pipeline, FrameByFrameItDrawsWhatAReplayDraws) {
  capture::Studio studio(bench().world, bench().options);
  auto replayed = Pipeline::create(studio.cameras(), bench().scene);
  PENUMBRA_NEED_GL(replayed);
  ASSERT_TRUE(replayed) << replayed.error().detail;
  std::vector<FramePixels> expected;
  ASSERT_TRUE(replayed->replay(studio, [&](const runtime::Output& out) {
    expected.push_back(*out.pixels);
    return true;
  }));

  capture::Studio again(bench().world, bench().options);
  auto stepped = *Pipeline::create(again.cameras(), bench().scene);
  // A replay's view frames wait for the whole bracket: so do these.
  std::vector<capture::Frame> waiting;
  std::size_t compared = 0;
  int exposures = 0;
  while (const auto frame = *again.next()) {
    if (stepped.shows_surroundings(frame->camera)) {
      EXPECT_TRUE(*stepped.add_environment(*frame));
      ++exposures;
    } else {
      waiting.push_back(*frame);
    }
    if (exposures < static_cast<int>(again.schedule().size())) continue;
    for (const capture::Frame& view : waiting) {
      const auto composited = stepped.composite(view);
      ASSERT_TRUE(composited) << composited.error().detail;
      ASSERT_LT(compared, expected.size());
      EXPECT_TRUE(composited->pixels == expected[compared++]);
    }
    waiting.clear();
  }
  EXPECT_EQ(compared, expected.size());
  EXPECT_TRUE(stepped.light().valid);
  EXPECT_TRUE(stepped.plan());
  EXPECT_FALSE(stepped.timings().summary().empty());
}

TEST(Pipeline, BeforeThereIsLightAFrameComesBackAsItIs) {
  auto pipeline = Pipeline::create(view_camera_alone(), bench().scene);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline) << pipeline.error().detail;
  capture::Frame frame = view_frame();
  frame.camera = 0;
  const auto dark = pipeline->composite(frame);
  ASSERT_TRUE(dark);
  EXPECT_TRUE(dark->pixels == *frame.pixels);

  lighting::LightEstimate light =
      *lighting::estimate_map(capture::make_room_environment(128, 64), {});
  pipeline->set_light(light);
  const auto lit = pipeline->composite(frame);
  ASSERT_TRUE(lit) << lit.error().detail;
  EXPECT_FALSE(lit->pixels == *frame.pixels);
}

// Of what it loads itself it keeps the patterns of transfer alone, and draws the same, also where
// shadows meet and one of the objects turns.
TEST(Pipeline, WhatItLoadsItKeepsInATenthOfTheRoom) {
  runtime::Scene scene;
  for (const double x : {-.3, .3}) {
    runtime::SceneObject box;
    box.name = x < 0 ? "left" : "right";
    box.asset = "builtin:box";
    box.albedo = {.6f, .5f, .4f};
    box.position = {x, 0, 0};
    box.place_on_floor = true;
    box.fit_size_m = .4;
    box.spin_rpm = x < 0 ? 20 : 0;
    scene.objects.push_back(box);
  }
  runtime::RealGeometry floor;
  floor.plane = runtime::RealPlane{};
  floor.albedo = Rgb{.4f, .3f, .2f};
  scene.real.push_back(floor);
  PipelineOptions options;
  options.bake = runtime::BakeSettings::coarse();
  options.bake.use_cache = false;
  options.bake.rays = options.bake.ground_rays = 64;
  const auto prepared = runtime::prepare(scene, options.bake, options.progress);
  ASSERT_TRUE(prepared) << prepared.error().detail;
  auto given = Pipeline::create(view_camera_alone(),
                                std::make_shared<const runtime::PreparedScene>(*prepared), options);
  PENUMBRA_NEED_GL(given);
  auto loaded = Pipeline::create(view_camera_alone(), scene, options);
  ASSERT_TRUE(given && loaded);
  const lighting::LightEstimate light =
      *lighting::estimate_map(capture::make_sky_environment(128, 64, .8), {});
  given->set_light(light), loaded->set_light(light);
  capture::Frame frame = view_frame();
  frame.camera = 0;
  for (int i = 0; i < 3; ++i) {
    frame.time = TimestampNs{i * 100'000'000};
    const auto expected = given->composite(frame), ours = loaded->composite(frame);
    ASSERT_TRUE(expected && ours);
    EXPECT_FALSE(ours->pixels == *frame.pixels);
    EXPECT_TRUE(ours->pixels == expected->pixels) << i;
  }
  const auto coefficients = [](const Pipeline& p) {
    std::size_t sum = 0;
    for (const runtime::PreparedObject& o : p.scene().objects)
      for (const prt::Transfer* t : {&o.baked.transfer, &o.baked.reflected, &o.baked.ground_deficit,
                                     &o.baked.ground_reflected})
        sum += t->values.size();
    return sum;
  };
  EXPECT_LT(10 * coefficients(*loaded), coefficients(*given));
  const auto again =
      Pipeline::create(view_camera_alone(),
                       std::make_shared<const runtime::PreparedScene>(loaded->scene()), options);
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().where, "left");
}

TEST(Pipeline, WithoutACameraThatShowsTheSurroundingsOnlySetLightGivesLight) {
  const std::vector<capture::CameraInfo> cameras = view_camera_alone();
  const auto check = Pipeline::check(cameras);
  ASSERT_FALSE(check);
  EXPECT_EQ(check.error().code, ErrorCode::kInvalid);
  auto pipeline = Pipeline::create(cameras, bench().scene);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline) << pipeline.error().detail;
  EXPECT_FALSE(pipeline->shows_surroundings(0));
  EXPECT_EQ(pipeline->add_environment(view_frame()).error().code, ErrorCode::kInvalid);
  capture::Studio studio(bench().world, bench().options);
  EXPECT_EQ(pipeline->replay(studio, [](const runtime::Output&) { return true; }).error().code,
            ErrorCode::kInvalid);
}

TEST(Pipeline, FramesAndSourcesOfOtherCamerasAreRefused) {
  const capture::Studio studio(bench().world, bench().options);
  auto pipeline = Pipeline::create(studio.cameras(), bench().scene);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline) << pipeline.error().detail;
  const auto refused = [](const auto& result) {
    return !result && result.error().code == ErrorCode::kInvalid;
  };
  const capture::Frame view = view_frame();
  EXPECT_TRUE(refused(pipeline->add_environment(view)));
  for (const int camera : {-1, 2, 1000}) {
    capture::Frame stray = view;
    stray.camera = camera;
    EXPECT_TRUE(refused(pipeline->add_environment(stray))) << camera;
    EXPECT_TRUE(refused(pipeline->composite(stray))) << camera;
    EXPECT_FALSE(pipeline->shows_surroundings(camera)) << camera;
  }
  capture::Frame empty = view;
  empty.pixels = nullptr;
  EXPECT_TRUE(refused(pipeline->composite(empty)));
  capture::Frame environment = view;
  environment.camera = 1 - view.camera;
  EXPECT_TRUE(refused(pipeline->composite(environment)));

  capture::StudioOptions larger = bench().options;
  larger.view_width *= 2;
  capture::Studio other(bench().world, larger);
  EXPECT_TRUE(refused(pipeline->replay(other, [](const runtime::Output&) { return true; })));
}

TEST(Pipeline, OptionsOutOfRangeAreRefusedByName) {
  const std::vector<capture::CameraInfo> cameras = view_camera_alone();
  // The name in the error of options with one of them changed.
  const auto name = [&](auto change) {
    PipelineOptions options;
    change(options);
    const auto made = Pipeline::create(cameras, bench().scene, options);
    return made ? std::string() : made.error().where;
  };
  EXPECT_EQ(name([](auto& o) { o.bands = 0; }), "bands");
  EXPECT_EQ(name([](auto& o) { o.bands = 10; }), "bands");
  EXPECT_EQ(name([](auto& o) { o.max_lights = 65; }), "max_lights");
  EXPECT_EQ(name([](auto& o) { o.max_shadow_error = 0; }), "max_shadow_error");
  EXPECT_EQ(name([](auto& o) { o.max_shadow_error = std::nan(""); }), "max_shadow_error");
  EXPECT_EQ(name([](auto& o) { o.progress = nullptr; }), "progress");
  const auto no_scene = Pipeline::create(cameras, std::shared_ptr<const runtime::PreparedScene>());
  EXPECT_EQ(no_scene.error().where, "scene");
}

TEST(Pipeline, WithoutAViewCameraThereIsNone) {
  std::vector<capture::CameraInfo> cameras =
      capture::Studio(bench().world, bench().options).cameras();
  std::erase_if(cameras, [](const auto& c) { return c.role == capture::Role::kView; });
  const auto pipeline = Pipeline::create(cameras, bench().scene);
  ASSERT_FALSE(pipeline);
  EXPECT_EQ(pipeline.error().detail, "has no view camera");
}

}  // namespace
}  // namespace penumbra
