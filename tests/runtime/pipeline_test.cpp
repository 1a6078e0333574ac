#include "runtime/pipeline/pipeline.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <initializer_list>
#include <utility>

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
  options.bake.cache = runtime::BakeCache::kNotUsed;
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

// The bench's sphere by another name, so far to the right.
runtime::PreparedScene spheres(std::initializer_list<std::pair<const char*, double>> places) {
  runtime::PreparedScene out = *bench().scene;
  const runtime::PreparedObject sphere = out.objects[0];
  out.objects.clear();
  for (const auto& [name, x] : places) {
    out.objects.push_back(sphere);
    out.objects.back().name = name;
    out.objects.back().world_from_bake.translation = {x, 0, 0};
  }
  return out;
}

TEST(Pipeline, AChangedSceneIsDrawnAsIfItHadBeenThereAndWhatStaysStaysPut) {
  auto pipeline = Pipeline::create(view_camera_alone(), runtime::Scene{});
  PENUMBRA_NEED_GL(pipeline);
  const lighting::LightEstimate light =
      *lighting::estimate_map(capture::make_sky_environment(128, 64, .8), {});
  capture::Frame frame = view_frame();
  frame.camera = 0;
  const auto drawn_by = [&](Pipeline& p) {
    p.set_light(light);
    return (*p.composite(frame)).pixels;
  };
  const auto drawn_from_the_start = [&](runtime::PreparedScene scene) {
    auto p = *Pipeline::create(view_camera_alone(),
                               std::make_shared<runtime::PreparedScene>(std::move(scene)));
    return drawn_by(p);
  };
  EXPECT_TRUE(drawn_by(*pipeline) == *frame.pixels);
  EXPECT_TRUE(pipeline->objects().empty());

  ASSERT_TRUE(pipeline->change_scene(spheres({{"first", 0}})));
  EXPECT_TRUE(drawn_by(*pipeline) == drawn_from_the_start(spheres({{"first", 0}})));
  ASSERT_EQ(pipeline->objects().size(), 1u);

  // It was moved by then, and so the scene's own place for it does not count.
  ASSERT_TRUE(pipeline->move_object("first", {{-.3, 0, 0}, .5}));
  ASSERT_TRUE(pipeline->change_scene(spheres({{"second", .3}, {"first", 0}})));
  const FramePixels both = drawn_by(*pipeline);
  auto expected = *Pipeline::create(
      view_camera_alone(),
      std::make_shared<runtime::PreparedScene>(spheres({{"second", .3}, {"first", 0}})));
  ASSERT_TRUE(expected.move_object("first", {{-.3, 0, 0}, .5}));
  EXPECT_TRUE(both == drawn_by(expected));
  const std::vector<runtime::ObjectState> now = pipeline->objects();
  ASSERT_EQ(now.size(), 2u);
  EXPECT_EQ(now[0].name, "second");
  EXPECT_NEAR(now[1].place.position_m.x, -.3, 1e-12);
  EXPECT_NEAR(now[1].place.turn_rad, .5, 1e-12);
  EXPECT_NEAR(now[1].rest_position_m.x, 0, 1e-12);
  EXPECT_NEAR(now[1].centre_m.y, .2, 1e-6);

  ASSERT_TRUE(pipeline->change_scene({}));
  EXPECT_TRUE(drawn_by(*pipeline) == *frame.pixels);
  EXPECT_EQ(pipeline->move_object("first", {}).error().code, ErrorCode::kNotFound);
}

// On threads: the run goes on, with its light, while the scene changes under it.
TEST(Pipeline, ALiveRunTakesUpAChangedSceneAndABudget) {
  capture::StudioOptions options = bench().options;
  options.view_frames = 400;
  options.view_fps = 100;
  capture::Studio studio(bench().world, options);
  auto made = Pipeline::create(studio.cameras(), runtime::Scene{});
  PENUMBRA_NEED_GL(made);
  Pipeline& pipeline = *made;
  EXPECT_EQ(pipeline.max_shadow_error(), .05);
  std::atomic<int> maps = 0;
  pipeline.watch_light([&](const Environment& map, const lighting::LightEstimate& light) {
    EXPECT_TRUE(light.valid);
    EXPECT_GT(map.radiance.width(), 0);
    ++maps;
  });
  int lit = 0, changed = 0, shown_after = 0;
  const auto sink = [&](const runtime::Output& out) {
    lit += out.light.valid;
    const bool touched = !(*out.pixels == *out.source.pixels);
    shown_after += touched;
    if (lit == 3 && changed == 0) {
      changed = 1;
      EXPECT_TRUE(pipeline.change_scene(*bench().scene));
      EXPECT_TRUE(pipeline.set_max_shadow_error(.2));
      EXPECT_FALSE(pipeline.set_max_shadow_error(0));
    }
    return shown_after < 3;
  };
  const auto counts = pipeline.run_live(studio, sink, std::atomic<bool>(false));
  ASSERT_TRUE(counts) << counts.error().detail;
  EXPECT_EQ(shown_after, 3);
  EXPECT_GT(maps, 0);
  EXPECT_EQ(pipeline.max_shadow_error(), .2);
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
