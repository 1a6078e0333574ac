// Where the headset output puts pictures and finds heads, by what the fake OpenXR runtime got.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "service/head_poses.h"
#include "tests/support/headset_fixture.h"

namespace penumbra::service {
namespace {

constexpr int kEyeEdge_px = 512;
constexpr double kTurn_deg_s = 100;

// As a camera of a headset: a fisheye that sits before the eye and looks a little outwards.
calib::CameraModel fisheye() {
  auto camera = *calib::make_projection(calib::ProjectionKind::kKannalaBrandt, 640, 640);
  camera.focal_px = {260, 261}, camera.principal_px = {318, 325};
  return *calib::with_distortion(camera, std::array{.02, -.01, .003, -.0004});
}
Pose head_from_camera(int eye) {
  const double side = eye == 0 ? -1 : 1;
  return {glm::angleAxis(.05 * side, glm::normalize(glm::dvec3(.3, -1, .1))),
          {.045 * side, -.02, -.07}};
}

// A picture that is black but for a spot at a point of the world.
EyePicture spot_picture(const calib::CameraModel& camera, const Pose& world_from_camera,
                        TimestampNs captured, const glm::dvec3& point) {
  auto pixels =
      std::make_shared<FramePixels>(Image<Rgb8>(camera.width, camera.height, Rgb8{0, 0, 0}));
  auto& picture = std::get<Image<Rgb8>>(*pixels);
  if (const auto at = calib::pixel_from_direction(camera, world_from_camera.inverse() * point)) {
    constexpr double kSigma_px = 2;
    for (int y = std::max(0, int(at->y) - 8); y < std::min(camera.height, int(at->y) + 9); ++y)
      for (int x = std::max(0, int(at->x) - 8); x < std::min(camera.width, int(at->x) + 9); ++x) {
        const double r2 = std::pow(x + .5 - at->x, 2) + std::pow(y + .5 - at->y, 2);
        const double linear = std::exp(-r2 / (2 * kSigma_px * kSigma_px));
        const double code =
            linear < .0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - .055;
        const auto c = static_cast<std::uint8_t>(std::lround(255 * code));
        picture.at(x, y) = {c, c, c};
      }
  }
  return {std::move(pixels), camera, world_from_camera, captured, {}, {}};
}

double linear_of(std::uint8_t code) {
  const double c = code / 255.;
  return c < .04045 ? c / 12.92 : std::pow((c + .055) / 1.055, 2.4);
}

// Where the light's centre is in an eye's picture, as tangents, x right and y up.
std::optional<glm::dvec2> spot_in(const FakeOpenXrView& view) {
  double sum = 0;
  glm::dvec2 at(0);
  for (int y = 0; y < view.height; ++y)
    for (int x = 0; x < view.width; ++x) {
      const auto i = 4 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(view.width) +
                          static_cast<std::size_t>(x));
      const double light = linear_of(view.rgba[i]);
      sum += light;
      at += light * glm::dvec2(x + .5, y + .5);
    }
  if (sum < .5) return std::nullopt;
  at /= sum;
  const double l = std::tan(view.fov[0]), r = std::tan(view.fov[1]), u = std::tan(view.fov[2]),
               d = std::tan(view.fov[3]);
  return glm::dvec2(l + (r - l) * at.x / view.width, d + (u - d) * at.y / view.height);
}

Pose pose_of(const FakeOpenXrView& view) {
  return {glm::dquat(view.rotation[3], view.rotation[0], view.rotation[1], view.rotation[2]),
          {view.position[0], view.position[1], view.position[2]}};
}

// Pixels between the spot of a view and a point of the world.
std::optional<double> miss_px(const FakeOpenXrView& view, const glm::dvec3& point) {
  const auto spot = spot_in(view);
  if (!spot) return std::nullopt;
  const glm::dvec3 in_eye = pose_of(view).inverse() * point;
  const glm::dvec2 right(in_eye.x / -in_eye.z, in_eye.y / -in_eye.z);
  const double px = view.width / (std::tan(view.fov[1]) - std::tan(view.fov[0]));
  return glm::length(*spot - right) * px;
}

// ---- Where a picture stands. ----

// What was captured when, of each eye.
struct SpotShown {
  TimestampNs captured;
  std::array<glm::dvec3, 2> points;
};

class HeadsetRate : public HeadsetOutput, public testing::WithParamInterface<double> {};

TEST_P(HeadsetRate, ATurningHeadSeesThingsWhereTheyAre) {
  fake_.turn("RATE_HZ", std::to_string(GetParam()));
  fake_.turn("TURN", std::to_string(kTurn_deg_s));
  fake_.turn("EDGE", std::to_string(kEyeEdge_px));
  fake_.turn("KEEP", "1");
  HeadsetOptions options;
  options.picture_distance_m = 1.5;
  PENUMBRA_START(options);
  ASSERT_TRUE(runs());
  std::mt19937 random(20261127);
  std::uniform_real_distribution<double> tangent(-.5, .5);
  std::vector<SpotShown> shown;
  for (int i = 0; i < 60; ++i) {
    const TimestampNs captured = now_ns() + Seconds(-.025);
    const Pose head = true_head(captured, kTurn_deg_s);
    SpotShown one{captured, {}};
    for (int eye = 0; eye < 2; ++eye) {
      const glm::dvec3 point = head * (1.5 * glm::dvec3(tangent(random), tangent(random), -1));
      one.points[static_cast<std::size_t>(eye)] = point;
      headset_->show(eye, spot_picture(fisheye(), head * head_from_camera(eye), captured, point));
    }
    shown.push_back(one);
    std::this_thread::sleep_for(std::chrono::milliseconds(18));
  }
  EXPECT_NEAR(headset_->state().rate_hz, GetParam(), .01);
  int seen = 0;
  double largest_px = 0;
  for (const FakeOpenXrFrame& frame : FakeHeadset::frames()) {
    ASSERT_EQ(frame.views.size(), 2u);
    if (frame.views[0].rgba.empty()) continue;
    // The pose that was submitted tells which picture it is.
    const Pose submitted = pose_of(frame.views[0]);
    const auto off = [&](const SpotShown& one) {
      const glm::dquat head = true_head(one.captured, kTurn_deg_s).rotation;
      return 2 * std::acos(std::min(1., std::abs(glm::dot(head, submitted.rotation))));
    };
    const auto nearest = std::ranges::min_element(shown, {}, off);
    EXPECT_LT(off(*nearest), 1e-3) << "not the pose of any capture";
    for (std::size_t eye = 0; eye < 2; ++eye) {
      const auto miss = miss_px(frame.views[eye], nearest->points[eye]);
      ASSERT_TRUE(miss) << "no spot";
      largest_px = std::max(largest_px, *miss);
      ++seen;
    }
  }
  RecordProperty("largest_miss_px", std::to_string(largest_px));
  EXPECT_GE(seen, 20) << "pictures came through";
  EXPECT_LT(largest_px, 1);
}

INSTANTIATE_TEST_SUITE_P(AtRates, HeadsetRate, testing::Values(72., 90.),
                         [](const auto& one) { return std::to_string(int(one.param)) + "Hz"; });

TEST_F(HeadsetOutput, TheFloorIsWhereTheFloorIs) {
  fake_.turn("EDGE", std::to_string(kEyeEdge_px));
  fake_.turn("KEEP", "1");
  HeadsetOptions options;
  options.picture_distance_m = 8;
  PENUMBRA_START(options);
  ASSERT_TRUE(runs());
  const glm::dvec3 on_floor(.1, 1.1, -.8);  // of a stage for someone who sits
  std::uint64_t pairs = 0;
  const auto largest_miss = [&] {
    // None of those before may be drawn later.
    EXPECT_TRUE(within(5, [&] {
      const HeadsetState s = headset_->state();
      return s.shown + s.overtaken + s.unplaced == pairs;
    }));
    FakeHeadset::frames();
    double largest = -1;
    within(5, [&] {
      const TimestampNs captured = now_ns() + Seconds(-.01);
      for (int eye = 0; eye < 2; ++eye)
        headset_->show(eye, spot_picture(fisheye(), true_head(captured, 0) * head_from_camera(eye),
                                         captured, on_floor));
      ++pairs;
      std::this_thread::sleep_for(std::chrono::milliseconds(40));
      const auto frames = FakeHeadset::frames();
      const auto drawn = std::ranges::find_if(
          frames, [](const FakeOpenXrFrame& f) { return !f.views[0].rgba.empty(); });
      if (drawn == frames.end()) return false;
      for (const FakeOpenXrView& view : drawn->views)
        largest = std::max(largest, miss_px(view, on_floor).value_or(1e9));
      return true;
    });
    return largest;
  };
  EXPECT_GT(largest_miss(), 2) << "the plane is far behind it, and the camera beside the eye";
  ASSERT_TRUE(headset_->set_floor_height(1.1));
  const double miss = largest_miss();
  EXPECT_GE(miss, 0);
  EXPECT_LT(miss, 1);
}

TEST_F(HeadsetOutput, CodesStayAndWhatTheCameraDoesNotSeeIsBlack) {
  fake_.turn("KEEP", "1");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  ASSERT_TRUE(shows(2));
  const auto frames = FakeHeadset::frames();
  const auto drawn = std::ranges::find_if(
      frames, [](const FakeOpenXrFrame& f) { return !f.views[1].rgba.empty(); });
  ASSERT_NE(drawn, frames.end());
  for (const FakeOpenXrView& view : drawn->views) {
    const auto at = [&](int x, int y, std::size_t c) {
      return int(view.rgba[4 * static_cast<std::size_t>(y * view.width + x) + c]);
    };
    EXPECT_NEAR(at(64, 64, 0), 200, 1);
    EXPECT_NEAR(at(64, 64, 1), 100, 1);
    EXPECT_NEAR(at(64, 64, 2), 50, 1);
    EXPECT_EQ(at(64, 2, 0), 0) << "the camera sees 60 degrees of the eye's 90";
    EXPECT_EQ(at(64, 125, 1), 0);
  }
}

TEST_F(HeadsetOutput, OnePictureServesAHeadsetOfOneView) {
  fake_.turn("VIEWS", "1");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(5));
  EXPECT_EQ(FakeHeadset::frames().back().views.size(), 1u);
}

// ---- Poses. ----

TEST_F(HeadsetOutput, TheHeadIsFoundAtEachTimeOfTheLastSeconds) {
  fake_.turn("TURN", std::to_string(kTurn_deg_s));
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  std::this_thread::sleep_for(std::chrono::milliseconds(700));
  const TimestampNs now = now_ns();
  int asked = 0, found = 0;
  for (double age_s = 0; age_s < .5; age_s += .0037) {
    const TimestampNs time = now + Seconds(-age_s);
    const auto head = headset_->head_at(time);
    ++asked;
    if (!head) continue;  // a machine with other work may leave gaps between frames
    ++found;
    EXPECT_TRUE(head->position_tracked && head->rotation_tracked);
    const glm::dquat right = true_head(time, kTurn_deg_s).rotation;
    const double cosine = std::abs(glm::dot(right, head->world_from_device.rotation));
    EXPECT_LT(2 * std::acos(std::min(1., cosine)), 1e-3) << age_s;
    EXPECT_NEAR(head->world_from_device.translation.y, kFakeOpenXrEyeHeight_m, 1e-5);
  }
  EXPECT_GE(found, asked * 2 / 3);
  EXPECT_FALSE(headset_->head_at(now + Seconds(-10)));
  EXPECT_FALSE(headset_->head_at(now + Seconds(10)));
  const auto hand = headset_->controller_at(Hand::kLeft, now + Seconds(-.05));
  ASSERT_TRUE(hand);
  EXPECT_NEAR(hand->world_from_device.translation.x, -.2, 1e-5);
  const auto other = headset_->controller_at(Hand::kRight, now);
  ASSERT_TRUE(other);
  EXPECT_NEAR(other->world_from_device.translation.x, .2, 1e-5);
}

TEST_F(HeadsetOutput, WithoutTrackingNothingIsPlaced) {
  fake_.turn("REFUSE", "tracking");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  EXPECT_FALSE(shows(1, .5));
  EXPECT_GT(headset_->state().unplaced, 0u);
  EXPECT_FALSE(headset_->head_at(now_ns()));
}

// ---- As poses of frames. ----

class PosesOfTheHead : public HeadsetOutput {
 protected:
  bool starts(std::optional<Hand> hand = {}) {
    if (!runs()) return false;
    poses_ = std::make_unique<HeadPoses>(std::shared_ptr<const Headset>(std::move(headset_)), hand);
    std::this_thread::sleep_for(std::chrono::milliseconds(300));
    return true;
  }
  ~PosesOfTheHead() override { poses_.reset(); }
  std::optional<capture::FramePose> pose_now() {
    capture::Frame frame;
    frame.time = now_ns() + Seconds(-.02);
    return poses_->pose_of(frame);
  }

  std::unique_ptr<HeadPoses> poses_;
};

TEST_F(PosesOfTheHead, AreTheTrackedOnes) {
  PENUMBRA_START();
  ASSERT_TRUE(starts());
  const auto pose = pose_now();
  ASSERT_TRUE(pose);
  EXPECT_NEAR(pose->pose.translation.y, kFakeOpenXrEyeHeight_m, 1e-5);
  EXPECT_LE(pose->sigma_m, .001);
  EXPECT_EQ(poses_->state().trouble, "");
  EXPECT_EQ(poses_->state().taken, 1u);
  EXPECT_THAT(poses_->state().name, ::testing::HasSubstr("openxr"));
}

// A camera that is fixed to a controller.
TEST_F(PosesOfTheHead, OrOfAController) {
  PENUMBRA_START();
  ASSERT_TRUE(starts(Hand::kRight));
  std::optional<capture::FramePose> pose;
  ASSERT_TRUE(within(5, [&] { return (pose = pose_now()).has_value(); }));
  EXPECT_NEAR(pose->pose.translation.x, .2, 1e-5);
  EXPECT_THAT(poses_->state().name, ::testing::HasSubstr("the right controller of"));
  capture::Frame old;
  old.time = now_ns() + Seconds(-10);
  EXPECT_FALSE(poses_->pose_of(old));
  EXPECT_THAT(poses_->state().trouble, ::testing::HasSubstr("no pose of the right controller"));
}

TEST_F(PosesOfTheHead, OfOneThatOnlyTurnsAreTakenAfterAWhileAndSaySo) {
  FakeHeadset::state().place_tracked = false;
  PENUMBRA_START();
  ASSERT_TRUE(starts());
  EXPECT_FALSE(pose_now()) << "a tracker may still find its place";
  EXPECT_THAT(poses_->state().trouble, ::testing::HasSubstr("waits whether it finds its place"));
  std::optional<capture::FramePose> pose;
  ASSERT_TRUE(within(5, [&] { return (pose = pose_now()).has_value(); }));
  EXPECT_GE(pose->sigma_m, .05);
  EXPECT_NEAR(pose->pose.translation.y, kFakeOpenXrEyeHeight_m, 1e-5);
  EXPECT_GT(poses_->state().refused, 0u);
  EXPECT_THAT(poses_->state().trouble, ::testing::HasSubstr("does not track where it is, only"));
  // A frame of a time of which nothing was heard: what is known of the headset stays known.
  capture::Frame old;
  old.time = now_ns() + Seconds(-10);
  EXPECT_FALSE(poses_->pose_of(old));
  EXPECT_THAT(poses_->state().trouble, ::testing::HasSubstr("tells no pose of the head"));
  EXPECT_TRUE(within(.5, [&] { return pose_now().has_value(); })) << "waits anew";
}

TEST_F(PosesOfTheHead, AreMissingWhileAPlaceThatWasTrackedIsLost) {
  PENUMBRA_START();
  ASSERT_TRUE(starts());
  ASSERT_TRUE(pose_now());
  FakeHeadset::state().place_tracked = false;
  ASSERT_TRUE(within(5, [&] { return !pose_now(); }));
  std::this_thread::sleep_for(std::chrono::milliseconds(2500));
  EXPECT_FALSE(pose_now());
}

}  // namespace
}  // namespace penumbra::service
