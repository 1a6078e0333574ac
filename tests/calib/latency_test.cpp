#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>

#include "calib/calib.h"
#include "core/conventions.h"

namespace penumbra::calib {
namespace {

constexpr double kTurnDegree = kPi / 180, kLate_s = .0435;

glm::dquat about(double degrees, const glm::dvec3& axis) {
  return glm::angleAxis(degrees * kTurnDegree, glm::normalize(axis));
}

// A hand that turns a rig to and fro, never the same way again.
glm::dquat by_hand(double t) {
  return about(22 * std::sin(2.1 * t) + 9 * std::sin(5.3 * t + 1), {0, 1, 0}) *
         about(14 * std::sin(3.4 * t), {1, .2, 0});
}

struct TurnedRig {
  std::vector<TurnSample> camera, tracker;
};
struct RigMotion {
  std::function<glm::dquat(double)> body = by_hand;
  double seconds = 8, fps = 30, poses_per_s = 120;
  double camera_noise = .05 * kTurnDegree, tracker_noise = .02 * kTurnDegree;
  double drift = 0;  // of the tracker's clock, seconds a second
};

TurnedRig turned_rig(unsigned seed, const RigMotion& m = {}) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> gauss(0, 1);
  const auto jitter = [&](double sigma) {
    return about(sigma / kTurnDegree * gauss(rng), {1, 0, 0}) *
           about(sigma / kTurnDegree * gauss(rng), {0, 1, 0}) *
           about(sigma / kTurnDegree * gauss(rng), {0, 0, 1});
  };
  const glm::dquat body_from_camera = about(71, {1, 2, -.5}), board = about(140, {0, 1, 1});
  TurnedRig out;
  for (int i = 0; i < m.seconds * m.fps; ++i) {
    const double t = i / m.fps;
    out.camera.push_back(
        {t, glm::conjugate(board) * m.body(t) * body_from_camera * jitter(m.camera_noise)});
  }
  for (int i = 0; i < (m.seconds + 2) * m.poses_per_s; ++i) {
    const double t = i / m.poses_per_s - 1;
    out.tracker.push_back({t * (1 + m.drift) + kLate_s, m.body(t) * jitter(m.tracker_noise)});
  }
  return out;
}

TEST(CameraLatency, IsFoundFarBelowAFrame) {
  const TurnedRig rig = turned_rig(1);
  const auto found = estimate_latency(rig.camera, rig.tracker);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->offset_s, kLate_s, .0006);
  EXPECT_LT(found->sigma_s, .0004);
  EXPECT_LT(found->residual_rad, .2 * kTurnDegree);
  EXPECT_GT(found->steps.size(), 200u);
  ASSERT_TRUE(found->drift_s);
  EXPECT_LT(std::abs(*found->drift_s), 4 * found->drift_sigma_s);

  // Naive: to whole frames, the shift at which the turning speeds agree best.
  const auto speed = [](const std::vector<TurnSample>& samples, double from_s, double to_s) {
    const auto at = [&](double t) {
      return std::ranges::lower_bound(samples, t, {}, &TurnSample::time_s)->turn;
    };
    return 2 * std::acos(std::min(1., std::abs(glm::dot(at(from_s), at(to_s)))));
  };
  double best = 1e9, shift_s = 0;
  for (int frames = -10; frames <= 10; ++frames) {
    double sum = 0;
    for (int i = 0; i < 200; ++i) {
      const double t = i / 30., d = speed(rig.camera, t, t + .1) -
                                    speed(rig.tracker, t + frames / 30., t + frames / 30. + .1);
      sum += d * d;
    }
    if (sum < best) best = sum, shift_s = frames / 30.;
  }
  EXPECT_GT(std::abs(shift_s - kLate_s), .005);
}

TEST(CameraLatency, TheStatedUncertaintyCoversTheTruth) {
  int covered = 0;
  constexpr int kRuns = 200;
  for (unsigned seed = 0; seed < kRuns; ++seed) {
    const TurnedRig rig = turned_rig(100 + seed);
    const auto found = estimate_latency(rig.camera, rig.tracker);
    ASSERT_TRUE(found) << seed << ": " << found.error().detail;
    covered += std::abs(found->offset_s - kLate_s) < 1.96 * found->sigma_s;
  }
  RecordProperty("covered", covered);
  EXPECT_NEAR(covered / double{kRuns}, .95, .035);
}

TEST(CameraLatency, NeedsNoSecondAxis) {
  const TurnedRig rig =
      turned_rig(2, {.body = [](double t) {
                   return about(25 * std::sin(1.9 * t) + 8 * std::sin(4.7 * t), {0, 1, 0});
                 }});
  const auto found = estimate_latency(rig.camera, rig.tracker);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->offset_s, kLate_s, .0005);
}

TEST(CameraLatency, MissingAndWrongPosesCostLittle) {
  TurnedRig rig = turned_rig(3);
  for (std::size_t i = 10; i < rig.camera.size(); i += 10)  // a board's pose that has flipped
    rig.camera[i].turn = rig.camera[i].turn * about(25, {1, 0, 0});
  std::erase_if(rig.camera, [](const TurnSample& s) { return s.time_s > 2 && s.time_s < 3; });
  std::erase_if(rig.tracker, [](const TurnSample& s) { return s.time_s > 5 && s.time_s < 5.8; });
  const auto found = estimate_latency(rig.camera, rig.tracker);
  ASSERT_TRUE(found) << found.error().detail;
  EXPECT_NEAR(found->offset_s, kLate_s, .001);
}

TEST(CameraLatency, ClocksThatRunApartAreTold) {
  const TurnedRig rig = turned_rig(4, {.drift = .001});
  const auto found = estimate_latency(rig.camera, rig.tracker);
  ASSERT_TRUE(found) << found.error().detail;
  ASSERT_TRUE(found->drift_s);
  EXPECT_NEAR(*found->drift_s, .004, .001);
  EXPECT_GT(*found->drift_s, 5 * found->drift_sigma_s);
}

// A tracker that ran for minutes more, and a hand that rests in the second half, in which a board
// was wrong once.
TEST(CameraLatency, RestTellsNothingAndCostsNothing) {
  TurnedRig rig = turned_rig(
      7, {.body = [](double t) { return by_hand(std::clamp(t, -1., 5.)); }, .seconds = 10});
  rig.camera[250].turn = rig.camera[250].turn * about(25, {1, 0, 0});
  TurnedRig long_log = rig;
  for (int i = 1; i < 300 * 60; ++i) {
    const double t = i / 60.;
    long_log.tracker.push_back({rig.tracker.back().time_s + t, rig.tracker.back().turn});
  }
  for (const TurnedRig& r : {rig, long_log}) {
    const auto found = estimate_latency(r.camera, r.tracker);
    ASSERT_TRUE(found) << found.error().detail;
    EXPECT_NEAR(found->offset_s, kLate_s, .001);
    EXPECT_FALSE(found->drift_s);
  }
}

std::string why_not(const TurnedRig& rig, const LatencyOptions& options = {}) {
  const auto found = estimate_latency(rig.camera, rig.tracker, options);
  return found ? "" : found.error().detail;
}

TEST(CameraLatency, WhatCannotTellIsRefused) {
  const auto says = [](const std::string& why, const char* part) {
    EXPECT_NE(why.find(part), std::string::npos) << why;
  };
  says(why_not(turned_rig(5, {.seconds = .5})), "pairs of pictures");
  says(why_not(turned_rig(5, {.body =
                                  [](double t) {
                                    return about(30 * t, {0, 1, 0});
                                  }})),
       "to and fro");
  says(why_not(turned_rig(5, {.body =
                                  [](double t) {
                                    return about(20 * std::sin(20 * t), {0, 1, 0});
                                  }})),
       "repeats itself");
  says(why_not(turned_rig(5), {.max_offset_s = .02}), "more than 20 ms apart");
  TurnedRig other = turned_rig(5);
  other.tracker = turned_rig(6, {.body = [](double t) { return by_hand(1.3 * t + 40); }}).tracker;
  EXPECT_FALSE(estimate_latency(other.camera, other.tracker));
  TurnedRig left_behind = turned_rig(5);
  for (TurnSample& s : left_behind.tracker) s.turn = {1, 0, 0, 0};
  says(why_not(left_behind), "is one fixed to the other");
  TurnedRig silent = turned_rig(5);
  silent.tracker.resize(200);
  says(why_not(silent), "too few of the times");
  TurnedRig other_epoch = turned_rig(5);
  for (TurnSample& t : other_epoch.tracker) t.time_s += 1000;
  says(why_not(other_epoch), "same moment");
  TurnedRig backwards = turned_rig(5);
  std::swap(backwards.tracker[3].time_s, backwards.tracker[4].time_s);
  says(why_not(backwards), "out of order");
  TurnedRig nan = turned_rig(5);
  nan.camera[7].turn.x = std::nan("");
  EXPECT_EQ(estimate_latency(nan.camera, nan.tracker).error().code, ErrorCode::kNonFinite);
  EXPECT_FALSE(estimate_latency({}, {}));
}

}  // namespace
}  // namespace penumbra::calib
