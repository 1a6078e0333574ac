#include "tools/runs/object_mouse.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <string>

#include "capture/capture.h"
#include "core/conventions.h"
#include "prt/prt.h"

namespace penumbra::tools {
namespace {

/// Two balls on a floor, and a camera that looks down on them.
class Mouse : public testing::Test {
 protected:
  Mouse() {
    for (const auto& [name, x] : {std::pair{"left", -.4}, {"right", .4}}) {
      runtime::PreparedObject o;
      o.name = name;
      o.baked.mesh = prt::make_sphere({0, .15f, 0}, .15f, 2, {.5f, .5f, .5f});
      o.baked.receiver = prt::Receiver{};
      o.world_from_bake = {{1, 0, 0, 0}, {x, 0, 0}};
      scene_.objects.push_back(o);
    }
    camera_ = *calib::make_projection(calib::ProjectionKind::kPinhole, 640, 480);
    world_from_camera_ = capture::look_at({0, 1.2, 2}, {0, 0, 0});
    mouse_.emplace(
        scene_,
        [this](std::string_view name, const runtime::ObjectPlace& place) {
          places_[std::string(name)] = place;
          return Result<void>{};
        },
        [this](std::string_view name, bool visible) {
          visible_[std::string(name)] = visible;
          return Result<void>{};
        },
        [this](std::string_view name, const runtime::ObjectPlayback& playback) {
          speeds_[std::string(name)] = playback.speed.value_or(NAN);
          return Result<void>{};
        });
  }
  glm::dvec2 seen(const glm::dvec3& world) const {
    const auto pixel =
        calib::pixel_from_direction(camera_, glm::normalize(world_from_camera_.inverse() * world));
    EXPECT_TRUE(pixel);
    return *pixel / glm::dvec2(camera_.width, camera_.height);
  }
  void at(const glm::dvec2& place, bool left, bool right = false, double wheel = 0) {
    mouse_->update({place, left, right, wheel}, camera_, world_from_camera_);
  }
  runtime::PreparedScene scene_;
  calib::CameraModel camera_;
  Pose world_from_camera_;
  std::optional<ObjectMouse> mouse_;
  std::map<std::string, runtime::ObjectPlace> places_;
  std::map<std::string, bool> visible_;
  std::map<std::string, double> speeds_;
};

TEST_F(Mouse, TheSpaceBarHoldsWhatTurnsAndLetsItGoOn) {
  scene_.objects[1].spin_rpm = 4;
  compositor::Pointer pointer;
  pointer.space = true;
  mouse_->update(pointer, camera_, world_from_camera_);
  EXPECT_EQ(speeds_, (std::map<std::string, double>{{"right", 0}}));
  mouse_->update({}, camera_, world_from_camera_);
  EXPECT_EQ(speeds_.at("right"), 0) << "a key that is not pressed";
  mouse_->update(pointer, camera_, world_from_camera_);
  EXPECT_EQ(speeds_.at("right"), 1);
}

TEST_F(Mouse, NumberKeysTakeObjectsAwayAndPutThemBack) {
  const auto press = [&](int key) {
    mouse_->update({{.5, .5}, false, false, 0, key}, camera_, world_from_camera_);
  };
  press(1);
  EXPECT_EQ(visible_, (std::map<std::string, bool>{{"left", false}}));
  at(seen({-.4, .15, 0}), false);
  at(seen({-.4, 0, 0}), true);
  at(seen({-.1, 0, .3}), true);
  EXPECT_TRUE(places_.empty()) << "what is not there cannot be dragged";
  at(seen({-.1, 0, .3}), false);
  press(0);
  press(3);
  EXPECT_EQ(visible_.size(), 1u) << "there is no third";
  press(1);
  EXPECT_TRUE(visible_.at("left"));
  press(2);
  EXPECT_FALSE(visible_.at("right"));
}

TEST_F(Mouse, DragsTheObjectUnderItAlongTheFloor) {
  at(seen({-.4, .15, 0}), false);
  at(seen({-.4, 0, 0}), true);  // its foot
  EXPECT_TRUE(places_.empty()) << "pressed, not yet moved";
  at(seen({-.1, 0, .3}), true);
  ASSERT_EQ(places_.size(), 1u);
  EXPECT_LT(glm::distance(places_.at("left").position_m, glm::dvec3(-.1, 0, .3)), 1e-6);
  at(seen({.2, 0, -.5}), true);
  at(seen({.2, 0, -.5}), false);
  at(seen({.9, 0, .9}), false);
  EXPECT_LT(glm::distance(places_.at("left").position_m, glm::dvec3(.2, 0, -.5)), 1e-6)
      << "let go, it stays";
  // Taken hold of above its foot it does not jump.
  places_.clear();
  const glm::dvec2 top = seen({.4, .25, 0});
  at(top, true);
  at(top, true);
  EXPECT_LT(glm::distance(places_.at("right").position_m, glm::dvec3(.4, 0, 0)), 1e-9);
}

TEST_F(Mouse, TurnsByTheWheelAndTheRightButton) {
  at(seen({.4, .15, 0}), false, false, 2);
  EXPECT_NEAR(places_.at("right").turn_rad, 20 * kPi / 180, 1e-12);
  at(seen({.4, .15, 0}), false);
  const glm::dvec2 hold = seen({-.4, .15, 0});
  at(hold, false, true);
  at(hold + glm::dvec2(.25, 0), false, true);
  EXPECT_NEAR(places_.at("left").turn_rad, kPi / 2, 1e-12);
  EXPECT_LT(glm::distance(places_.at("left").position_m, glm::dvec3(-.4, 0, 0)), 1e-9);
}

TEST_F(Mouse, LiftsWithShiftAndLeansByTheRightButton) {
  const glm::dvec2 hold = seen({-.4, .15, 0});
  const auto with_shift = [&](const glm::dvec2& place) {
    compositor::Pointer pointer{place, true};
    pointer.shift = true;
    mouse_->update(pointer, camera_, world_from_camera_);
  };
  with_shift(hold);
  with_shift(hold - glm::dvec2(0, .1));
  const double height = places_.at("left").position_m.y;
  EXPECT_GT(height, .1);
  EXPECT_NEAR(places_.at("left").position_m.x, -.4, 1e-12);
  with_shift(hold + glm::dvec2(0, .5));
  EXPECT_NEAR(places_.at("left").position_m.y, 0, 1e-12) << "never below its floor";
  at(hold, false);
  at(hold, false, true);
  at(hold - glm::dvec2(0, .1), false, true);
  EXPECT_NEAR(places_.at("left").lean_rad, .1 * kPi, 1e-12);
  EXPECT_NEAR(std::abs(places_.at("left").lean_towards_rad), kPi, .02) << "away from the camera";
  at(hold, false, true);
  EXPECT_NEAR(places_.at("left").lean_rad, 0, 1e-9) << "and back";
}

TEST_F(Mouse, BesideObjectsAndInTheSkyItMovesNothing) {
  at(seen({0, 0, .6}), true);
  at(seen({.2, 0, .6}), true);
  at(seen({.2, 0, .6}), false, false, 1);
  EXPECT_TRUE(places_.empty());
  at(seen({-.4, .15, 0}), false);
  at(seen({-.4, .15, 0}), true);
  world_from_camera_ = capture::look_at({0, 1.2, 2}, {0, 1.3, 0});  // no floor in view
  at({.5, .1}, true);
  EXPECT_TRUE(places_.empty());
}

// Onto an object that the mouse has crossed with its button held nothing happens either.
TEST_F(Mouse, TakesHoldOnlyWhereTheButtonWentDown) {
  at(seen({0, 0, .6}), true);
  at(seen({-.4, .1, 0}), true);
  at(seen({0, 0, 0}), true);
  EXPECT_TRUE(places_.empty());
}

}  // namespace
}  // namespace penumbra::tools
