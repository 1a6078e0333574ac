// The headset output over the fake OpenXR runtime: what becomes of pictures and sessions when the
// runtime goes, ends, or never comes.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "core/io/log.h"
#include "tests/support/headset_fixture.h"

namespace penumbra::service {
namespace {

// ---- Sessions. ----

TEST_F(HeadsetOutput, ARuntimeThatGoesIsFoundAgain) {
  fake_.turn("LOSE_AFTER", "40");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(5));
  ASSERT_TRUE(within(5, [&] { return headset_->state().phase == HeadsetPhase::kLost; }));
  EXPECT_EQ(headset_->state().trouble, "the OpenXR runtime has gone");
  ASSERT_TRUE(runs()) << "two seconds later";
  EXPECT_TRUE(shows(5));
  const HeadsetState state = headset_->state();
  EXPECT_EQ(state.restarts, 1u);
  EXPECT_EQ(state.trouble, "");
  EXPECT_EQ(FakeHeadset::state().instances_made, 2);
}

TEST_F(HeadsetOutput, ARuntimeThatComesLateIsFound) {
  fake_.uninstall();
  PENUMBRA_START();
  ASSERT_TRUE(within(5, [&] { return !headset_->state().trouble.empty(); }));
  EXPECT_EQ(headset_->state().phase, HeadsetPhase::kLost);
  fake_.install();
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(3));
  EXPECT_EQ(headset_->state().runtime, "fake 1.0.0");
  EXPECT_EQ(headset_->state().headset, "fake headset");
  EXPECT_TRUE(headset_->state().on_stage);
}

TEST_F(HeadsetOutput, AHeadsetThatIsPutDownAndOnGoesOn) {
  fake_.turn("PUT_DOWN", "30 60");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  ASSERT_TRUE(within(5, [&] { return headset_->state().phase == HeadsetPhase::kIdle; }));
  const std::uint64_t before = headset_->state().shown;
  headset_->show(-1, plain_picture({9, 9, 9}, now_ns()));
  std::this_thread::sleep_for(std::chrono::milliseconds(60));
  EXPECT_EQ(headset_->state().shown, before) << "nobody looks";
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(3));
}

TEST_F(HeadsetOutput, ItLeavesInOrderWithinASecond) {
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(3));
  const auto begin = std::chrono::steady_clock::now();
  headset_.reset();
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(1));
  EXPECT_EQ(FakeHeadset::state().sessions_left, 1) << "asked, ended, destroyed";
  EXPECT_EQ(FakeHeadset::state().sessions, 0);
}

TEST_F(HeadsetOutput, ASessionThatNeverGetsReadyIsLeftWithinASecond) {
  fake_.turn("REFUSE", "ready");
  PENUMBRA_START();
  ASSERT_TRUE(within(5, [&] { return headset_->state().phase == HeadsetPhase::kIdle; }));
  const auto begin = std::chrono::steady_clock::now();
  headset_.reset();
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(1));
}

TEST_F(HeadsetOutput, ARuntimeWithoutWhatIsNeededIsRefusedByName) {
  const auto need = start();
  PENUMBRA_NEED_GL(need);
  headset_.reset();
  for (const auto& [knob, extension] :
       {std::pair("egl glx", "XR_MNDX_egl_enable"), {"clock", "XR_KHR_convert_timespec"}}) {
    fake_.turn("REFUSE", knob);
    const auto refused = start();
    ASSERT_FALSE(refused) << knob;
    EXPECT_EQ(refused.error().code, ErrorCode::kUnavailable);
    EXPECT_NE(refused.error().detail.find(extension), std::string::npos) << refused.error().detail;
  }
}

TEST_F(HeadsetOutput, AHeadsetThatIsNotPluggedInIsWaitedFor) {
  fake_.turn("REFUSE", "system");
  PENUMBRA_START();
  // Debian's loader may still know the extensions of another test's runtime once.
  EXPECT_TRUE(within(5, [&] {
    return headset_->state().trouble == "fake 1.0.0 has no headset: is it plugged in?";
  })) << headset_->state().trouble;
  EXPECT_EQ(headset_->state().phase, HeadsetPhase::kLost);
}

// ---- Pictures. ----

TEST_F(HeadsetOutput, AnEyeWithoutItsOtherHalfIsCounted) {
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  const TimestampNs first = now_ns(), second = first + Seconds(.018);
  headset_->show(0, plain_picture({1, 1, 1}, first));
  headset_->show(0, plain_picture({1, 1, 1}, second));
  EXPECT_EQ(headset_->state().unmatched, 1u);
  headset_->show(1, plain_picture({1, 1, 1}, second + Seconds(.0004)));
  EXPECT_EQ(headset_->state().unmatched, 1u);
  EXPECT_TRUE(within(3, [&] { return headset_->state().shown == 1; }));
  headset_->show(1, plain_picture({1, 1, 1}, second + Seconds(.018)));
  headset_->show(0, plain_picture({1, 1, 1}, second + Seconds(.036)));
  EXPECT_EQ(headset_->state().unmatched, 2u) << "the right one's other half never came";
}

TEST_F(HeadsetOutput, TheNewestPictureWins) {
  fake_.turn("RATE_HZ", "20");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  for (int i = 0; i < 100; ++i) headset_->show(-1, plain_picture({1, 1, 1}, now_ns()));
  ASSERT_TRUE(within(3, [&] {
    const HeadsetState s = headset_->state();
    return s.shown + s.overtaken + s.unplaced == 100;
  }));
  EXPECT_GT(headset_->state().overtaken, 90u);
}

TEST_F(HeadsetOutput, HostileValuesAreRefusedOnceInWords) {
  PENUMBRA_START();
  ASSERT_TRUE(runs()) << "what it says until then is of the loader";
  std::mutex mutex;
  std::vector<std::string> lines;
  set_log_sink([&](LogLevel level, std::string_view line) {
    const std::scoped_lock lock(mutex);
    if (level == LogLevel::kWarning) lines.emplace_back(line);
  });
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  for (int i = 0; i < 3; ++i) {
    EyePicture one = plain_picture({1, 1, 1}, now_ns());
    one.world_from_camera.translation.x = kNan;
    headset_->show(0, one);
    one = plain_picture({1, 1, 1}, now_ns());
    one.world_from_camera.rotation = {2, 0, 0, 0};
    headset_->show(1, one);
    one = plain_picture({1, 1, 1}, now_ns());
    one.camera.width = 65;
    headset_->show(-1, one);
    one.pixels = nullptr;
    headset_->show(-1, one);
    headset_->show(2, plain_picture({1, 1, 1}, now_ns()));
    one = plain_picture({1, 1, 1}, now_ns());
    one.camera.focal_px.y = kNan;
    headset_->show(0, one);
  }
  set_log_sink({});
  EXPECT_EQ(headset_->state().refused, 18u);
  std::ranges::sort(lines);
  EXPECT_EQ(lines, (std::vector<std::string>{
                       "headset: has no such eye",
                       "headset: the left picture: has a camera without focal lengths",
                       "headset: the left picture: has a pose that is not finite",
                       "headset: the picture: has 64x48 pixels, but its camera has 65x48",
                       "headset: the picture: has no pixels",
                       "headset: the right picture: has a rotation that is not of unit length"}));
  std::vector<HeadsetOptions> bad(4);
  bad[0].picture_distance_m = kNan;
  bad[1].near_m = 0;
  bad[2].floor_height_m = 1e9;
  bad[3].application = "";
  for (const HeadsetOptions& options : bad) {
    const auto refused = Headset::create(options);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  }
  EXPECT_FALSE(headset_->set_picture_distance(-1));
  EXPECT_FALSE(headset_->set_floor_height(kNan));
  EXPECT_TRUE(headset_->set_picture_distance(3));
}

TEST_F(HeadsetOutput, LatenciesGoFromCaptureToTheDisplay) {
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  for (int i = 0; i < 20; ++i) {
    EyePicture one = plain_picture({1, 1, 1}, now_ns() + Seconds(-.03));
    one.lit = one.captured + Seconds(-.1);
    one.composited = now_ns();
    headset_->show(-1, one);
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  std::map<std::string, StageTimes::Percentiles> found;
  for (const auto& [name, times] : headset_->state().latency) found[name] = times;
  ASSERT_EQ(found.size(), 4u);
  const double submit = found["capture_to_submit"].p50_ms;
  EXPECT_GE(submit, 30);
  EXPECT_GT(found["capture_to_display"].p50_ms, submit) << "it is shown after it is handed over";
  EXPECT_NEAR(found["light_age_at_display"].p50_ms, found["capture_to_display"].p50_ms + 100, 20);
  EXPECT_LT(found["composite_to_submit"].p50_ms, submit);
  EXPECT_GT(found["capture_to_display"].count, 5u);
}

}  // namespace
}  // namespace penumbra::service
