#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "calib/calib.h"
#include "calib/track/pose_filter.h"
#include "core/conventions.h"

namespace penumbra::calib {
namespace {

constexpr double kDegree = kPi / 180, kFps = 30;
constexpr double kNoise_rad = .0006, kNoise_m = .0008;  // a board at a metre

glm::dvec3 turned_by(const glm::dquat& from, const glm::dquat& to) {
  glm::dquat d = to * glm::conjugate(from);
  if (d.w < 0) d = -d;
  return 2. * glm::dvec3(d.x, d.y, d.z);  // small
}

// Measurements with the noise that their covariance tells.
class NoisyPoses {
 public:
  explicit NoisyPoses(unsigned seed) : rng_(seed) {}
  TrackedPose measure(int picture, const Pose& truth) {
    TrackedPose out;
    out.time = TimestampNs{5'000'000'000} + Seconds(picture / kFps);
    const glm::dvec3 w = kNoise_rad * gauss();
    out.world_from_camera = {
        glm::normalize(glm::dquat(1, w.x / 2, w.y / 2, w.z / 2) * truth.rotation),
        truth.translation + kNoise_m * gauss()};
    for (std::size_t i = 0; i < 6; ++i)
      out.covariance[7 * i] = i < 3 ? kNoise_rad * kNoise_rad : kNoise_m * kNoise_m;
    return out;
  }

 private:
  glm::dvec3 gauss() { return {normal_(rng_), normal_(rng_), normal_(rng_)}; }
  std::mt19937 rng_;
  std::normal_distribution<double> normal_{0, 1};
};

TEST(PoseFilter, HalvesTheJitterOfACameraThatStands) {
  NoisyPoses noisy(3);
  PoseFilter filter;
  const Pose truth{glm::angleAxis(.4, glm::dvec3(0, 1, 0)), {.1, .8, 1.1}};
  double raw_rad = 0, raw_m = 0, rad = 0, m = 0;
  for (int i = 0; i < 900; ++i) {
    const TrackedPose measured = noisy.measure(i, truth), smooth = filter.update(measured);
    if (i < 60) continue;
    const auto square = [](const glm::dvec3& v) { return glm::dot(v, v); };
    raw_rad += square(turned_by(truth.rotation, measured.world_from_camera.rotation));
    rad += square(turned_by(truth.rotation, smooth.world_from_camera.rotation));
    raw_m += square(measured.world_from_camera.translation - truth.translation);
    m += square(smooth.world_from_camera.translation - truth.translation);
  }
  std::printf("jitter: rotation 1/%.2f, position 1/%.2f\n", std::sqrt(raw_rad / rad),
              std::sqrt(raw_m / m));
  EXPECT_LT(rad, raw_rad / 4);  // of the variance
  EXPECT_LT(m, raw_m / 4);
}

TEST(PoseFilter, FollowsConstantTurningAndSpeedWithoutLag) {
  constexpr double kTurn = 100 * kDegree, kSpeed = .5;  // a second
  NoisyPoses noisy(4);
  PoseFilter filter;
  double lag_s = 0, way_lag_s = 0;
  int count = 0;
  for (int i = 0; i < 600; ++i) {
    const double t = i / kFps;
    const Pose truth{glm::angleAxis(kTurn * t, glm::dvec3(0, 1, 0)), {kSpeed * t, .5, 1}};
    const TrackedPose smooth = filter.update(noisy.measure(i, truth));
    if (i < 10) continue;
    lag_s -= turned_by(truth.rotation, smooth.world_from_camera.rotation).y / kTurn;
    way_lag_s -= (smooth.world_from_camera.translation.x - truth.translation.x) / kSpeed;
    ++count;
  }
  std::printf("mean lag: rotation %.3f ms, position %.3f ms\n", 1e3 * lag_s / count,
              1e3 * way_lag_s / count);
  EXPECT_LT(std::abs(lag_s / count), .001);
  EXPECT_LT(std::abs(way_lag_s / count), .001);
}

TEST(PoseFilter, FollowsAHandWithoutMeanLag) {
  NoisyPoses noisy(5);
  PoseFilter filter;
  double squares = 0, raw = 0, along = 0, speed2 = 0;
  for (int i = 0; i < 900; ++i) {
    const double t = i / kFps, angle = .5 * std::sin(2.5 * t), rate = 1.25 * std::cos(2.5 * t);
    const Pose truth{glm::angleAxis(angle, glm::dvec3(0, 1, 0)), {0, .5, 1}};
    const TrackedPose measured = noisy.measure(i, truth), smooth = filter.update(measured);
    if (i < 30) continue;
    const double off = turned_by(truth.rotation, smooth.world_from_camera.rotation).y;
    const double raw_off = turned_by(truth.rotation, measured.world_from_camera.rotation).y;
    squares += off * off, raw += raw_off * raw_off;
    along -= off * rate, speed2 += rate * rate;
  }
  std::printf("hand: lag %.2f ms, error %.2f of the measurement's\n", 1e3 * along / speed2,
              std::sqrt(squares / raw));
  EXPECT_LT(std::abs(along / speed2), .001);
  EXPECT_LT(squares, 1.2 * raw);
}

TEST(PoseFilter, FollowsAJumpWithinThreePictures) {
  NoisyPoses noisy(6);
  PoseFilter filter;
  Pose truth{glm::angleAxis(.4, glm::dvec3(0, 1, 0)), {.1, .8, 1.1}};
  for (int i = 0; i < 200; ++i) filter.update(noisy.measure(i, truth));
  truth.translation += glm::dvec3(.4, .1, 0);
  truth.rotation = glm::angleAxis(.6, glm::dvec3(1, 0, 0)) * truth.rotation;
  for (int i = 200; i < 203; ++i) {
    const TrackedPose smooth = filter.update(noisy.measure(i, truth));
    if (i < 202) continue;
    EXPECT_LT(glm::length(smooth.world_from_camera.translation - truth.translation), 5 * kNoise_m);
    EXPECT_LT(glm::length(turned_by(truth.rotation, smooth.world_from_camera.rotation)),
              5 * kNoise_rad);
  }
}

TEST(PoseFilter, HoldsASingleWrongPoseBack) {
  NoisyPoses noisy(7);
  PoseFilter filter;
  const Pose truth{glm::angleAxis(.4, glm::dvec3(0, 1, 0)), {.1, .8, 1.1}};
  Pose wrong = truth;
  wrong.translation.x += .5;
  for (int i = 0; i < 100; ++i) {
    const TrackedPose smooth = filter.update(noisy.measure(i, i == 60 ? wrong : truth));
    EXPECT_LT(glm::length(smooth.world_from_camera.translation - truth.translation), .005) << i;
  }
}

TEST(PoseFilter, BeginsAnewAfterAPause) {
  NoisyPoses noisy(8);
  PoseFilter filter;
  const Pose one{}, other{{1, 0, 0, 0}, {2, 0, 0}};
  filter.update(noisy.measure(0, one));
  filter.update(noisy.measure(1, one));
  const TrackedPose later = noisy.measure(40, other);
  EXPECT_EQ(filter.update(later).world_from_camera, later.world_from_camera);
}

}  // namespace
}  // namespace penumbra::calib
