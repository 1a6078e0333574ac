#include "runtime/shading/object_moves.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <fstream>
#include <thread>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/pipeline/stage_access.h"
#include "runtime/shading/composite_stage.h"
#include "tests/support/gl.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"

namespace penumbra::runtime {
namespace {

BakeSettings quick() {
  return {.bands = 3,
          .bounces = 1,
          .rays = 64,
          .ground_rays = 64,
          .visibility = false,
          .cache = test::shared_bakes()};
}

SceneObject thing(const char* name, const glm::dvec3& position, double turn_rad = 0) {
  SceneObject o;
  o.name = name;
  o.asset = "builtin:twist";
  o.place_on_floor = true;
  o.fit_size_m = .3;
  o.position = position;
  o.rotation = glm::angleAxis(turn_rad, glm::dvec3(0, 1, 0));
  return o;
}

Scene scene_of(std::vector<SceneObject> objects) {
  RealGeometry floor;
  floor.plane = RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  return {std::move(objects), {floor}};
}

std::shared_ptr<const PreparedScene> prepared(const Scene& scene) {
  auto out = prepare(scene, quick(), [](const std::string&) { return [](double) {}; });
  EXPECT_TRUE(out) << out.error().detail;
  return std::make_shared<const PreparedScene>(out ? std::move(*out) : PreparedScene{});
}

// ------------------------------------------------------------------------------- what is drawn

capture::StudioOptions view() {
  capture::StudioOptions o;
  o.environment_width = 128, o.environment_height = 64;
  o.view_width = 192, o.view_height = 128;
  o.view_focal_px = 160;
  o.view_frames = 8;
  o.world_from_view = capture::look_at({.2, .7, 1.6}, {0, .15, 0});
  o.sensor.response = calib::Response::srgb();
  return o;
}

/// A sun and a sky, and one view camera that looks at the floor.
class MovedObjects : public testing::Test {
 protected:
  MovedObjects()
      : world_(*capture::FloorWorld::make(capture::make_sky_environment(256, 128, .7))),
        studio_(world_, view()) {
    light_ = *lighting::estimate_map(capture::make_sky_environment(256, 128, .7), {});
    while (auto frame = *studio_.next())
      if (studio_.cameras()[static_cast<std::size_t>(frame->camera)].role == capture::Role::kView)
        frames_.push_back(*frame);
  }
  Result<Pipeline> pipeline(const Scene& scene) {
    auto out = Pipeline::create(studio_.cameras(), prepared(scene));
    if (out) out->set_light(light_);
    return out;
  }
  Image<Rgb8> drawn(Pipeline& pipeline, std::size_t frame) {
    auto out = pipeline.composite(frames_[frame]);
    EXPECT_TRUE(out) << out.error().detail;
    return std::get<Image<Rgb8>>(out->pixels);
  }
  std::shared_ptr<const capture::RadianceWorld> world_;
  capture::Studio studio_;
  lighting::LightEstimate light_;
  std::vector<capture::Frame> frames_;
};

// Pixels that differ by more than a few codes.
std::size_t different(const Image<Rgb8>& a, const Image<Rgb8>& b, int codes) {
  std::size_t out = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    const Rgb8 &p = a.pixels()[i], &q = b.pixels()[i];
    out += std::max({std::abs(p.r - q.r), std::abs(p.g - q.g), std::abs(p.b - q.b)}) > codes;
  }
  return out;
}

// Moved to a place, all of it looks as if the scene had it there: object, shadow, and what another
// one takes of its light.
TEST_F(MovedObjects, LookAsIfTheSceneHadThemThere) {
  const glm::dvec3 from(-.3, 0, .1), to(.25, 0, -.1), neighbour(.02, 0, .05);
  const double turn = 1.1;
  auto moved = pipeline(scene_of({thing("moved", from), thing("other", neighbour)}));
  PENUMBRA_NEED_GL(moved);
  ASSERT_TRUE(moved) << moved.error().detail;
  auto there = *pipeline(scene_of({thing("moved", to, turn), thing("other", neighbour)}));
  const Image<Rgb8> before = drawn(*moved, 0);
  ASSERT_TRUE(moved->move_object("moved", {to, turn}));
  drawn(*moved, 1);  // what things reflect onto each other is a frame old
  drawn(there, 1);
  const Image<Rgb8> after = drawn(*moved, 2), truth = drawn(there, 2);
  EXPECT_GT(different(before, after, 8), 500u) << "it moved";
  EXPECT_LT(different(after, truth, 3), 20u);
  // And back again, in small steps, as it was.
  for (int i = 1; i <= 4; ++i)
    ASSERT_TRUE(moved->move_object("moved", {to + i / 4. * (from - to), turn * (1 - i / 4.)}));
  drawn(*moved, 0);
  EXPECT_LT(different(before, drawn(*moved, 0), 3), 20u);
}

// Lifted, put back and lifted again: the same pictures, and in the end the first one.
TEST_F(MovedObjects, LiftedAndPutBackLookAsBefore) {
  const glm::dvec3 there(-.1, 0, .1), up(-.1, .15, .1);
  auto live = pipeline(scene_of({thing("moved", there), thing("other", {.3, 0, .05})}));
  PENUMBRA_NEED_GL(live);
  ASSERT_TRUE(live) << live.error().detail;
  const auto settled = [&](const ObjectPlace& place) {
    EXPECT_TRUE(live->move_object("moved", place));
    for (std::size_t i = 0; i < 4; ++i) drawn(*live, i);
    return drawn(*live, 4);
  };
  const Image<Rgb8> standing = settled({there}), lifted = settled({up}),
                    leaning = settled({there, 0, .5, .7});
  EXPECT_GT(different(standing, lifted, 8), 500u);
  EXPECT_GT(different(standing, leaning, 8), 200u);
  EXPECT_LT(different(lifted, settled({up}), 3), 5u);
  EXPECT_LT(different(standing, settled({there}), 3), 20u);
}

// What it was lit for when it was hidden is not what it comes back to.
TEST_F(MovedObjects, HiddenWhileLiftedAndPutBackItStandsInTheLightThere) {
  const glm::dvec3 there(-.1, 0, .1), up(-.1, .15, .1);
  auto live = pipeline(scene_of({thing("moved", there)}));
  PENUMBRA_NEED_GL(live);
  ASSERT_TRUE(live) << live.error().detail;
  const auto settled = [&] {
    for (std::size_t i = 0; i < 4; ++i) drawn(*live, i);
    return drawn(*live, 4);
  };
  const Image<Rgb8> standing = settled();
  ASSERT_TRUE(live->move_object("moved", {up, 0, 2.5, .7}));
  EXPECT_GT(different(standing, settled(), 8), 200u);
  ASSERT_TRUE(live->show_object("moved", false));
  settled();
  ASSERT_TRUE(live->move_object("moved", {there}));
  ASSERT_TRUE(live->show_object("moved", true));
  EXPECT_LT(different(standing, settled(), 3), 20u);
}

TEST_F(MovedObjects, ATrackIsFollowedByTheFramesTimes) {
  const glm::dvec3 a(-.3, 0, .1), b(.3, 0, 0);
  auto tracked = pipeline(scene_of({thing("walker", a)}));
  PENUMBRA_NEED_GL(tracked);
  ASSERT_TRUE(tracked) << tracked.error().detail;
  const double begin = (frames_[1].time - TimestampNs{0}).count(),
               end = (frames_[5].time - TimestampNs{0}).count();
  ASSERT_TRUE(tracked->follow({{{begin, "walker", {a, 0}}, {end, "walker", {b, 2}}}}));
  for (const std::size_t frame : {std::size_t{0}, std::size_t{3}, std::size_t{7}}) {
    const double t = (frames_[frame].time - TimestampNs{0}).count(),
                 fraction = std::clamp((t - begin) / (end - begin), 0., 1.);
    auto there = *pipeline(scene_of({thing("walker", a + fraction * (b - a), 2 * fraction)}));
    EXPECT_LT(different(drawn(*tracked, frame), drawn(there, frame), 3), 20u) << frame;
  }
}

// Taken away, nothing of it stays in the picture: neither its shadow nor what it takes of others'
// light, nor of that of real things. Put back, it is there in the very next frame.
TEST_F(MovedObjects, TakenAwayAllLooksAsIfTheSceneHadThemNot) {
  const SceneObject gone = thing("gone", {-.1, 0, .12}), stays = thing("stays", {.15, 0, -.05});
  RealGeometry box;
  box.mesh = "builtin:box";
  box.albedo = Rgb{.5f, .5f, .5f};
  box.place_on_floor = true;
  box.fit_size_m = .25;
  box.position = {-.35, 0, -.15};
  RealGeometry wall;
  wall.plane = RealPlane{{0, 0, -.5}, {0, 0, 1}};
  wall.albedo = Rgb{.6f, .5f, .4f};
  const std::vector<RealGeometry> none, boxes{box}, boxes_and_wall{box, wall};
  for (const auto& things : {none, boxes, boxes_and_wall}) {
    Scene both = scene_of({gone, stays}), alone = scene_of({stays});
    for (const RealGeometry& r : things) both.real.push_back(r), alone.real.push_back(r);
    auto shown = pipeline(both);
    PENUMBRA_NEED_GL(shown);
    ASSERT_TRUE(shown) << shown.error().detail;
    both.objects[0].visible = false;
    auto hidden = *pipeline(both), without = *pipeline(alone);
    drawn(*shown, 0);
    const Image<Rgb8> before = drawn(*shown, 1);
    drawn(without, 0);
    const Image<Rgb8> truth = drawn(without, 1);
    EXPECT_GT(different(before, truth, 8), 500u) << "it is seen";
    drawn(hidden, 0);
    EXPECT_LT(different(drawn(hidden, 1), truth, 3), 20u) << things.size();
    ASSERT_TRUE(shown->show_object("gone", false));
    EXPECT_LT(different(drawn(*shown, 1), truth, 12), 20u) << "gone at once";
    // What things reflect onto each other is a frame old.
    EXPECT_LT(different(drawn(*shown, 1), truth, 3), 20u) << things.size();
    for (Pipeline* const p : {&*shown, &hidden}) {
      ASSERT_TRUE(p->show_object("gone", true));
      EXPECT_LT(different(drawn(*p, 1), before, 12), 20u) << "there at once";
      EXPECT_LT(different(drawn(*p, 1), before, 3), 20u) << things.size();
    }
  }
}

// What is sent to each other is seen a frame later, by both eyes at the same time.
TEST_F(MovedObjects, BothEyesSeeTheSame) {
  auto both = pipeline(scene_of({thing("moved", {-.3, 0, .1}), thing("other", {.15, 0, -.05})}));
  PENUMBRA_NEED_GL(both);
  ASSERT_TRUE(both) << both.error().detail;
  CompositeStage& stage = StageAccess::stage_of(*both);
  constexpr int kLeft = 1, kRight = 2;
  const auto settle = [&](double seconds) {
    for (int i = 0; i < 4; ++i) stage.shade(light_, seconds, kLeft);
  };
  settle(1);
  ASSERT_TRUE(both->move_object("moved", {{-.05, 0, .05}, 0}));
  EXPECT_TRUE(stage.shade(light_, 2, kLeft));
  EXPECT_FALSE(stage.shade(light_, 2, kRight)) << "the same moment";
  EXPECT_TRUE(stage.shade(light_, 3, kLeft)) << "what came of the move";
  EXPECT_FALSE(stage.shade(light_, 3, kRight));
  settle(3);
  EXPECT_FALSE(stage.shade(light_, 3, kLeft)) << "that comes to an end";
}

// Another thread moves, hides and shows while frames are drawn: each frame comes, and what was
// asked for last is what is seen in the end.
TEST_F(MovedObjects, AreChangedByAnotherThreadWhileTheyAreDrawn) {
  const glm::dvec3 rest(-.1, 0, .12);
  auto live = pipeline(scene_of({thing("moved", rest), thing("other", {.15, 0, -.05})}));
  PENUMBRA_NEED_GL(live);
  ASSERT_TRUE(live) << live.error().detail;
  drawn(*live, 0);
  const Image<Rgb8> before = drawn(*live, 0);
  std::atomic<int> refused = 0;
  std::jthread other([&](const std::stop_token& stop) {
    for (int i = 0; !stop.stop_requested(); ++i) {
      const double x = .01 * (i % 30);
      refused += !live->move_object("moved", {rest + glm::dvec3(x, 0, 0), x});
      refused += !live->show_object(i % 2 ? "moved" : "other", i % 3 != 0);
      refused += live->show_object("nobody", false).has_value();
    }
  });
  for (std::size_t i = 0; i < 12; ++i)
    ASSERT_TRUE(live->composite(frames_[i % frames_.size()])) << i;
  other.request_stop();
  other.join();
  EXPECT_EQ(refused, 0);
  for (const char* const name : {"moved", "other"}) ASSERT_TRUE(live->show_object(name, true));
  ASSERT_TRUE(live->move_object("moved", {rest, 0}));
  drawn(*live, 0);
  EXPECT_LT(different(drawn(*live, 0), before, 3), 20u);
}

// -------------------------------------------------------------------------------- what is told

TEST(ObjectMoves, UnknownNamesAreNeitherShownNorTakenAway) {
  const auto scene = prepared(scene_of({thing("cup", {0, 0, 0})}));
  ObjectMoves moves(*scene);
  const auto unknown = moves.show("cap", false);
  ASSERT_FALSE(unknown);
  EXPECT_EQ(unknown.error().code, ErrorCode::kNotFound);
  EXPECT_NE(unknown.error().detail.find("did you mean \"cup\""), std::string::npos);
  EXPECT_TRUE(moves.at(0, 0).visible);
  // Moved while it is away it is back at its new place.
  ASSERT_TRUE(moves.show("cup", false));
  ASSERT_TRUE(moves.put("cup", {{.5, 0, .2}, 0}));
  EXPECT_FALSE(moves.at(0, 0).visible);
  ASSERT_TRUE(moves.show("cup", true));
  EXPECT_NEAR(moves.at(0, 0).world_from_bake.translation.x, .5, 1e-12);
}

TEST(ObjectMoves, BadPlacesAreRefusedAndChangeNothing) {
  const auto scene = prepared(scene_of({thing("cup", {0, 0, 0})}));
  ObjectMoves moves(*scene);
  const Pose before = moves.at(0, 0).world_from_bake;
  const auto unknown = moves.put("cap", {});
  ASSERT_FALSE(unknown);
  EXPECT_EQ(unknown.error().code, ErrorCode::kNotFound);
  EXPECT_NE(unknown.error().detail.find("cup"), std::string::npos) << unknown.error().detail;
  for (const ObjectPlace& place : {ObjectPlace{{NAN, 0, 0}, 0}, ObjectPlace{{0, 0, 0}, INFINITY}})
    EXPECT_EQ(moves.put("cup", place).error().code, ErrorCode::kNonFinite);
  for (const ObjectPlace& place :
       {ObjectPlace{{0, -.2, 0}, 0}, ObjectPlace{{1e9, 0, 0}, 0}, ObjectPlace{{0, 1e5, 0}, 0},
        ObjectPlace{{0, 0, 0}, 1e30}, ObjectPlace{{0, 0, 0}, 0, 0, -1e30}})
    EXPECT_EQ(moves.put("cup", place).error().code, ErrorCode::kInvalid);
  EXPECT_EQ(moves.put("cup", {{0, 0, 0}, 0, NAN}).error().code, ErrorCode::kNonFinite);
  const auto track = moves.follow({{{0, "cup", {{1, 0, 0}, 0}}, {1.5, "cup", {{1, -3, 0}, 0}}}});
  ASSERT_FALSE(track);
  EXPECT_NE(track.error().where.find("1.5 s"), std::string::npos) << track.error().where;
  for (const double second : {1., 0., double(NAN)})
    EXPECT_EQ(moves.follow({{{1, "cup", {}}, {second, "cup", {}}}}).error().code,
              ErrorCode::kInvalid);
  EXPECT_EQ(moves.at(0, 0).world_from_bake, before);
  EXPECT_TRUE(moves.put("cup", {{1, -.002, -2}, .5}));
  EXPECT_NEAR(moves.at(0, 0).world_from_bake.translation.x, 1, 1e-12);
  EXPECT_NEAR(moves.at(0, 0).world_from_bake.translation.y, 0, 1e-12) << "on its plane";
}

// Above its plane an object is lifted; it leans about its middle, and its lowest point stays at its
// height.
TEST(ObjectMoves, LiftAndLeanOverTheFloor) {
  const auto scene = prepared(scene_of({thing("cup", {0, 0, 0})}));
  ObjectMoves moves(*scene);
  const prt::Mesh& mesh = scene->objects[0].baked.mesh;
  const glm::dvec3 middle(prt::bounds_of(mesh).centre());
  const auto lowest = [&](const Pose& pose) {
    double low = HUGE_VAL;
    for (const glm::vec3& p : mesh.positions) low = std::min(low, (pose * glm::dvec3(p)).y);
    return low;
  };
  EXPECT_FALSE(moves.at(0, 0).lifted);
  const double at_rest = lowest(moves.at(0, 0).world_from_bake);
  ASSERT_TRUE(moves.put("cup", {{.3, .2, .1}, .5}));
  const ObjectMoves::ObjectNow lifted = moves.at(0, 1);
  EXPECT_TRUE(lifted.lifted);
  EXPECT_NEAR(lifted.world_from_bake.translation.y - lifted.world_from_floor.translation.y, .2,
              1e-12);
  EXPECT_NEAR(moves.states()[0].height_m, .2, 1e-12);
  for (const double towards : {0., .5 * kPi, 4.})
    for (const double lean : {.3, 1.6, kPi}) {
      ASSERT_TRUE(moves.put("cup", {{.3, .2, .1}, .5, lean, towards}));
      const ObjectMoves::ObjectNow now = moves.at(0, 1);
      EXPECT_NEAR(lowest(now.world_from_bake), at_rest + .2, 1e-6) << lean << " " << towards;
      const glm::dvec3 up = now.world_from_bake.rotation * glm::dvec3(0, 1, 0),
                       before = now.world_from_floor * middle, after = now.world_from_bake * middle;
      EXPECT_NEAR(up.y, std::cos(lean), 1e-9);
      EXPECT_NEAR(before.x, after.x, 1e-9) << "about its middle";
      EXPECT_NEAR(before.z, after.z, 1e-9);
      if (lean < 2) {
        const glm::dvec3 way = glm::angleAxis(.5, glm::dvec3(0, 1, 0)) *
                               glm::dvec3(std::sin(towards), 0, std::cos(towards));
        EXPECT_NEAR(glm::dot(up, way), std::sin(lean), 1e-9) << "towards its own z at 0, x at 90";
      }
    }
  // Halfway between two keys it leans half as much.
  ASSERT_TRUE(
      moves.follow({{{0, "cup", {{0, 0, 0}, 0, .4, 1}}, {1, "cup", {{0, 0, 0}, 0, .8, 1}}}}));
  EXPECT_NEAR((moves.at(0, .5).world_from_bake.rotation * glm::dvec3(0, 1, 0)).y, std::cos(.6),
              1e-9);
  ASSERT_TRUE(moves.put("cup", {{0, 0, 0}, 0}));
  EXPECT_FALSE(moves.at(0, 2).lifted);
  EXPECT_EQ(moves.at(0, 2).world_from_bake, scene->objects[0].world_from_bake);
}

// It lands without a jump, and is lit as it stands near its plane.
TEST(ObjectMoves, TheLastCentimetreIsDrawn) {
  const auto scene = prepared(scene_of({thing("cup", {0, 0, 0})}));
  ObjectMoves moves(*scene);
  for (const double height : {.02, .012, .004, .001, 0.}) {
    ASSERT_TRUE(moves.put("cup", {{.3, height, .1}, .5}));
    const ObjectMoves::ObjectNow now = moves.at(0, 1);
    EXPECT_NEAR(now.world_from_bake.translation.y - now.world_from_floor.translation.y, height,
                1e-12);
    EXPECT_EQ(now.lifted, height > .01) << height;
  }
}

// One leaning turntable does not stagger: its axis leans.
TEST(ObjectMoves, ATurntableThatLeansTurnsAboutItsOwnAxis) {
  SceneObject o = thing("cup", {0, 0, 0});
  o.spin_rpm = 10;
  const auto scene = prepared(scene_of({o}));
  ObjectMoves moves(*scene);
  ASSERT_TRUE(moves.put("cup", {{0, .1, 0}, .5, .4, 1.1}));
  const glm::dvec3 way =
      glm::angleAxis(.5, glm::dvec3(0, 1, 0)) * glm::dvec3(std::sin(1.1), 0, std::cos(1.1));
  const glm::dvec3 nose = moves.at(0, 0).world_from_bake.rotation * glm::dvec3(0, 0, 1);
  for (const double t : {0., 1., 2.5}) {
    const glm::dquat turn = moves.at(0, t).world_from_bake.rotation;
    EXPECT_NEAR(glm::dot(turn * glm::dvec3(0, 1, 0), way), std::sin(.4), 1e-9) << t;
    EXPECT_NEAR(glm::dot(moves.states()[0].forward, glm::dvec3(std::sin(.5), 0, std::cos(.5))), 1,
                1e-9);
    if (t > 0) EXPECT_LT(glm::dot(turn * glm::dvec3(0, 0, 1), nose), .9) << "it turns";
  }
}

// A scene whose floor is lower, with the object on it: a place on the old floor is none there.
TEST(ObjectMoves, APlaceGoesOnOnItsOwnPlaneAlone) {
  const auto scene = prepared(scene_of({thing("cup", {0, 0, 0})}));
  ObjectMoves moves(*scene);
  ASSERT_TRUE(moves.put("cup", {{.2, 0, 0}}));
  Scene lower = scene_of({thing("cup", {0, -.1, 0})});
  lower.real[0].plane->point.y = -.1;
  const auto below = prepared(lower);
  ObjectMoves next(*below);
  next.go_on_from(moves);
  EXPECT_NEAR(next.states()[0].height_m, 0, 1e-9);
  EXPECT_NEAR(next.states()[0].place.position_m.y, -.1, 1e-9);
  ObjectMoves same(*scene);
  same.go_on_from(moves);
  EXPECT_NEAR(same.states()[0].place.position_m.x, .2, 1e-9);
}

TEST(ObjectMoves, WhatPlaysAClipIsNeitherLiftedNorLeaned) {
  SceneObject walker;
  walker.name = "walker";
  walker.asset = "builtin:walker";
  walker.animation = "Walk";
  walker.live = true;
  const auto scene = prepared(scene_of({walker}));
  ObjectMoves moves(*scene);
  for (const ObjectPlace& place : {ObjectPlace{{0, .3, 0}}, ObjectPlace{{0, 0, 0}, 0, .2}}) {
    const auto refused = moves.put("walker", place);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
    EXPECT_NE(refused.error().detail.find("clip"), std::string::npos);
  }
  EXPECT_FALSE(moves.states()[0].lifts);
}

TEST(ObjectMoves, PlaybackStandsStillGoesBackAndGoesOnFromWhereItHasComeTo) {
  Scene scene = scene_of({thing("turning", {}), thing("still", {1, 0, 0})});
  scene.objects[0].spin_rpm = 3;
  const auto ready = prepared(scene);
  ObjectMoves moves(*ready);
  EXPECT_EQ(moves.at(0, 1.25).clip_time_s, 1.25) << "to the bit, as long as nobody asks";
  ASSERT_TRUE(moves.play("turning", {.speed = 0}));
  const ObjectMoves::ObjectNow held = moves.at(0, 2);
  EXPECT_EQ(held.clip_time_s, 2);
  const Pose later = moves.at(0, 7).world_from_bake;
  EXPECT_EQ(later.rotation, held.world_from_bake.rotation) << "the turntable stands";
  ASSERT_TRUE(moves.play("turning", {.speed = -2}));
  EXPECT_EQ(moves.at(0, 8).clip_time_s, 2) << "from where it has come to";
  EXPECT_EQ(moves.at(0, 9).clip_time_s, 0);
  ASSERT_TRUE(moves.play("turning", {.clip_time_s = 5}));
  ASSERT_TRUE(moves.play("turning", {.speed = 1})) << "before a frame: both count";
  EXPECT_EQ(moves.at(0, 10).clip_time_s, 5);
  EXPECT_EQ(moves.at(0, 10.5).clip_time_s, 5.5);
  EXPECT_EQ(moves.at(1, 10.5).clip_time_s, 10.5) << "others go on";
}

TEST(ObjectMoves, BadPlaybacksAreRefusedAndChangeNothing) {
  Scene scene = scene_of({thing("turning", {}), thing("still", {1, 0, 0})});
  scene.objects[0].spin_rpm = 3;
  const auto ready = prepared(scene);
  ObjectMoves moves(*ready);
  EXPECT_EQ(moves.play("turnin", {}).error().code, ErrorCode::kNotFound);
  EXPECT_EQ(moves.play("turning", {.speed = NAN}).error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(moves.play("turning", {.clip_time_s = INFINITY}).error().code, ErrorCode::kNonFinite);
  EXPECT_EQ(moves.play("turning", {.blend_weight = .5}).error().code, ErrorCode::kInvalid);
  const auto still = moves.play("still", {.speed = 0});
  ASSERT_FALSE(still);
  EXPECT_EQ(still.error().where, "object \"still\"");
  EXPECT_EQ(still.error().detail, "has neither a clip nor a turntable");
  EXPECT_EQ(moves.at(0, 3).clip_time_s, 3);
}

TEST(ObjectMoves, ATurntableGoesOnTurning) {
  SceneObject o = thing("cup", {0, 0, 0}, .3);
  o.spin_rpm = 10;
  const auto scene = prepared(scene_of({o}));
  ObjectMoves moves(*scene);
  ASSERT_TRUE(moves.put("cup", {{1, 0, 0}, .7}));
  const glm::dvec3 nose(0, 0, 1);
  for (const double t : {0., 1., 2.5}) {
    const double turn = .3 + .7 + 2 * kPi / 6 * t;
    const glm::dvec3 at = moves.at(0, t).world_from_bake * nose;
    EXPECT_NEAR(at.x, 1 + std::sin(turn), 1e-9) << t;
    EXPECT_NEAR(at.z, std::cos(turn), 1e-9) << t;
  }
}

class TrackFile : public testing::Test {
 protected:
  Result<ObjectTrack> read(const std::string& text) {
    std::ofstream(path(), std::ios::binary) << text;
    return read_object_track(path());
  }
  std::filesystem::path path() const { return folder_.path() / "moves.csv"; }
  void expect_invalid(const std::string& text, int line, const std::string& word) {
    const auto track = read(text);
    ASSERT_FALSE(track) << text;
    EXPECT_EQ(track.error().where, path().string() + ":" + std::to_string(line)) << text;
    EXPECT_NE(track.error().detail.find(word), std::string::npos) << track.error().detail;
  }
  test::TempFolder folder_;
};

constexpr const char* kHead = "time_s,object,x_m,y_m,z_m,turn_deg\n";

TEST_F(TrackFile, IsReadAsItStands) {
  const auto track = read(std::string("\xef\xbb\xbf") + kHead +
                          "0,a cup,1,0,-2.5,90\r\n\n .5 , a cup , 1e0 , .25,0 ,-180\n1,b,0,0,0,0");
  ASSERT_TRUE(track) << track.error().detail;
  ASSERT_EQ(track->keys.size(), 3u);
  EXPECT_EQ(track->keys[0].object, "a cup");
  EXPECT_EQ(track->keys[0].place.position_m, glm::dvec3(1, 0, -2.5));
  EXPECT_NEAR(track->keys[0].place.turn_rad, kPi / 2, 1e-12);
  EXPECT_EQ(track->keys[1].time_s, .5);
  EXPECT_NEAR(track->keys[1].place.turn_rad, -kPi, 1e-12);
  EXPECT_EQ(track->keys[2].object, "b");
}

TEST_F(TrackFile, HasColumnsForWhatLeans) {
  const std::string head = "time_s,object,x_m,y_m,z_m,turn_deg,lean_deg,lean_towards_deg\n";
  const auto track = read(head + "0,cup,1,.5,-2,90,30,180\n");
  ASSERT_TRUE(track) << track.error().detail;
  EXPECT_NEAR(track->keys[0].place.lean_rad, kPi / 6, 1e-12);
  EXPECT_NEAR(track->keys[0].place.lean_towards_rad, kPi, 1e-12);
  expect_invalid(head + "0,cup,1,.5,-2,90\n", 2, "8 columns");
}

TEST_F(TrackFile, DamagedOnesAreNamedByFileAndLine) {
  const std::string head = kHead;
  EXPECT_EQ(read("").error().code, ErrorCode::kInvalid);
  expect_invalid("time,object\n0,a", 1, "time_s,object");
  expect_invalid(head + "0,a,1,2,3\n", 2, "columns");
  expect_invalid(head + "0,a,1,2,3,4,5\n", 2, "columns");
  expect_invalid(head + "0,a,1,2,x,4\n", 2, "\"x\"");
  expect_invalid(head + "0,a,1,2,nan,4\n", 2, "\"nan\"");
  expect_invalid(head + "1,a,1,2,3,4\n\n1,a,1,2,3,4\n", 4, "not after");
  EXPECT_EQ(read_object_track(folder_.path() / "none.csv").error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace penumbra::runtime
