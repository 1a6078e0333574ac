#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "capture/poses/pose_history.h"
#include "core/conventions.h"
#include "core/io/log.h"

namespace penumbra::capture {
namespace {

using testing::HasSubstr;

constexpr double kEps = 1e-9;

TimestampNs at_ms(double ms) {
  return TimestampNs{10'000'000'000} + Seconds(ms / 1000);
}
TimedPose pose_at(double ms, double x, double angle = 0) {
  return {at_ms(ms), {glm::angleAxis(angle, glm::dvec3(0, 1, 0)), {x, 0, 0}}, .001, .002};
}
double angle_of(const Pose& p) {
  return 2 * std::atan2(p.rotation.y, p.rotation.w);
}

TEST(PoseHistory, KnowsNothingBeforeItsFirstPose) {
  PoseHistory history;
  EXPECT_FALSE(history.at(at_ms(0)));
  EXPECT_FALSE(history.newest());
  ASSERT_TRUE(history.put(pose_at(10, 0)));
  EXPECT_FALSE(history.at(at_ms(9.999)));
  EXPECT_TRUE(history.at(at_ms(10)));
}

TEST(PoseHistory, GivesConstantMotionBackBetweenItsPoses) {
  PoseHistory history;
  for (int i = 0; i <= 10; ++i) ASSERT_TRUE(history.put(pose_at(20 * i, .02 * i, .05 * i)));
  for (double ms = 0; ms < 200; ms += 3.3) {
    const auto p = history.at(at_ms(ms));
    ASSERT_TRUE(p) << ms;
    EXPECT_NEAR(p->pose.translation.x, .001 * ms, kEps);
    EXPECT_NEAR(angle_of(p->pose), .0025 * ms, kEps);
    EXPECT_EQ(p->extrapolated, Seconds(0));
  }
}

TEST(PoseHistory, TakesPosesInAnyOrderOfTheLastSecond) {
  PoseHistory in_order, mixed;
  for (int i = 0; i <= 20; ++i) ASSERT_TRUE(in_order.put(pose_at(20 * i, .01 * i * i / 20.)));
  for (const int i : {0, 2, 1, 5, 4, 3, 20, 8, 6, 7, 19, 12, 10, 9, 11, 18, 15, 13, 14, 16, 17})
    ASSERT_TRUE(mixed.put(pose_at(20 * i, .01 * i * i / 20.))) << i;
  for (double ms = 0; ms < 400; ms += 7)
    EXPECT_EQ(in_order.at(at_ms(ms))->pose, mixed.at(at_ms(ms))->pose) << ms;
}

TEST(PoseHistory, APoseOfATimeThatIsThereReplacesIt) {
  PoseHistory history;
  ASSERT_TRUE(history.put(pose_at(0, 0)));
  ASSERT_TRUE(history.put(pose_at(20, .01)));
  ASSERT_TRUE(history.put(pose_at(20, .011)));
  EXPECT_EQ(history.size(), 2u);
  EXPECT_NEAR(history.at(at_ms(20))->pose.translation.x, .011, kEps);
}

TEST(PoseHistory, SaysHowSureItIsByItsFormula) {
  PoseHistory history;
  ASSERT_TRUE(history.put(pose_at(0, 0)));
  ASSERT_TRUE(history.put(pose_at(40, .02)));
  EXPECT_NEAR(history.at(at_ms(0))->sigma_m, .001, kEps);
  const auto middle = history.at(at_ms(20));
  EXPECT_NEAR(middle->sigma_m, std::hypot(.001 * std::sqrt(.5), 3 * .25 * .04 * .04 / 2), kEps);
  const auto beyond = history.at(at_ms(60));
  const double r = .5, e = .02;
  EXPECT_NEAR(
      beyond->sigma_m,
      std::sqrt(std::pow((1 + r) * .001, 2) + std::pow(r * .001, 2) + std::pow(3 * e * e / 2, 2)),
      kEps);
  EXPECT_NEAR(
      beyond->sigma_rad,
      std::sqrt(std::pow((1 + r) * .002, 2) + std::pow(r * .002, 2) + std::pow(15 * e * e / 2, 2)),
      kEps);
}

TEST(PoseHistory, GoesOnForOnePeriodAndThenIsStale) {
  PoseHistory history({.max_extrapolation = Seconds(.025)});
  for (int i = 0; i <= 10; ++i) ASSERT_TRUE(history.put(pose_at(10 * i, .02 * i, .03 * i)));
  double before = 0;
  for (double ms = 101; ms <= 125; ms += 4) {
    const auto p = history.at(at_ms(ms));
    ASSERT_TRUE(p) << ms;
    EXPECT_NEAR(p->pose.translation.x, .002 * ms, kEps);
    EXPECT_NEAR(angle_of(p->pose), .003 * ms, kEps);
    EXPECT_NEAR(p->extrapolated.count(), (ms - 100) / 1000, kEps);
    EXPECT_GT(p->sigma_m, before);
    before = p->sigma_m;
  }
  EXPECT_FALSE(history.at(at_ms(126)));
}

TEST(PoseHistory, AGapIsNotBridged) {
  PoseHistory history({.max_gap = Seconds(.1), .max_extrapolation = Seconds(.02)});
  ASSERT_TRUE(history.put(pose_at(0, 0)));
  ASSERT_TRUE(history.put(pose_at(10, .01)));
  ASSERT_TRUE(history.put(pose_at(300, .1)));
  EXPECT_NEAR(history.at(at_ms(25))->pose.translation.x, .025, kEps);  // by the last velocity
  EXPECT_FALSE(history.at(at_ms(100)));
  EXPECT_TRUE(history.at(at_ms(300)));
}

TEST(PoseHistory, AJumpNeedsASecondWitness) {
  PoseHistory history;
  for (int i = 0; i <= 5; ++i) ASSERT_TRUE(history.put(pose_at(20 * i, 0)));
  ASSERT_TRUE(history.put(pose_at(120, 2)));  // 100 m/s
  EXPECT_EQ(history.newest(), at_ms(100));
  ASSERT_TRUE(history.put(pose_at(140, 0)));  // it was wrong
  EXPECT_EQ(history.refused(), 1u);
  EXPECT_NEAR(history.at(at_ms(130))->pose.translation.x, 0, kEps);
  ASSERT_TRUE(history.put(pose_at(160, 2)));
  ASSERT_TRUE(history.put(pose_at(180, 2.01)));  // it was right
  EXPECT_EQ(history.newest(), at_ms(180));
  EXPECT_NEAR(history.at(at_ms(170))->pose.translation.x, 2.005, kEps);
  // In between the nearer one, never the way through the air.
  EXPECT_NEAR(history.at(at_ms(145))->pose.translation.x, 0, kEps);
  EXPECT_NEAR(history.at(at_ms(155))->pose.translation.x, 2, kEps);
  EXPECT_NEAR(history.at(at_ms(190))->pose.translation.x, 2.015, kEps);
}

TEST(PoseHistory, AFastTurnIsAJumpToo) {
  PoseHistory history;
  ASSERT_TRUE(history.put(pose_at(0, 0, 0)));
  ASSERT_TRUE(history.put(pose_at(20, 0, 1)));  // 50 rad/s
  EXPECT_EQ(history.newest(), at_ms(0));
  ASSERT_TRUE(history.put(pose_at(40, 0, .3)));
  EXPECT_EQ(history.newest(), at_ms(40));
}

TEST(PoseHistory, RefusesWhatIsNoPose) {
  PoseHistory history;
  TimedPose bad = pose_at(0, 0);
  bad.world_from_body.translation.y = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(history.put(bad).error().code, ErrorCode::kNonFinite);
  bad = pose_at(0, 0);
  bad.world_from_body.rotation = {1.1, 0, 0, 0};
  EXPECT_THAT(history.put(bad).error().detail, HasSubstr("unit length"));
  bad.world_from_body.rotation = {0, 0, 0, 0};
  EXPECT_FALSE(history.put(bad));
  bad = pose_at(0, 0);
  bad.sigma_m = -1;
  EXPECT_FALSE(history.put(bad));
  bad = pose_at(0, 0);
  bad.time.value = std::numeric_limits<std::int64_t>::max();
  EXPECT_THAT(history.put(bad).error().detail, HasSubstr("clock"));
  EXPECT_EQ(history.refused(), 5u);
  EXPECT_EQ(history.size(), 0u);
}

TEST(PoseHistory, ASenderThatBeginsAnewIsFollowedAndSaidOnce) {
  std::vector<std::string> lines;
  set_log_sink([&](LogLevel, std::string_view line) { lines.emplace_back(line); });
  PoseHistory history({.name = "headset"});
  for (int i = 0; i <= 5; ++i) ASSERT_TRUE(history.put(pose_at(5000 + 20 * i, 0)));
  // One alone may have been on its way for long.
  EXPECT_THAT(history.put(pose_at(100, 9)).error().detail, HasSubstr("5.0 s older"));
  ASSERT_TRUE(history.put(pose_at(5120, 0)));
  EXPECT_EQ(history.restarts(), 0u);
  for (int round = 0; round < 2; ++round) {
    EXPECT_FALSE(history.put(pose_at(10, 1)));
    EXPECT_TRUE(history.put(pose_at(30, 1)));
    EXPECT_EQ(history.newest(), at_ms(30));
    EXPECT_EQ(history.size(), 2u);
    ASSERT_TRUE(history.put(pose_at(3000, 1)));
  }
  EXPECT_EQ(history.restarts(), 2u);
  set_log_sink({});
  ASSERT_EQ(lines.size(), 1u);
  EXPECT_THAT(lines[0], HasSubstr("headset: the sender's clock went back by 5.1 s"));
}

TEST(PoseHistory, KeepsNoMoreThanItsCapacity) {
  PoseHistory history({.capacity = 16});
  for (int i = 0; i < 1000; ++i) ASSERT_TRUE(history.put(pose_at(10 * i, .001 * i)));
  EXPECT_EQ(history.size(), 16u);
  EXPECT_FALSE(history.at(at_ms(9000)));
  EXPECT_TRUE(history.at(at_ms(9900)));
}

}  // namespace
}  // namespace penumbra::capture
