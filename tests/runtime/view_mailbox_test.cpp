#include "runtime/pipeline/internal/view_mailbox.h"

#include <gtest/gtest.h>

#include <vector>

#include "runtime/pipeline/eye_moments.h"

namespace penumbra::runtime {
namespace {

std::vector<capture::CameraInfo> stereo_cameras() {
  std::vector<capture::CameraInfo> out(3);
  out[0].role = capture::Role::kView, out[0].eye = "left";
  out[1].role = capture::Role::kEnvironment;
  out[2].role = capture::Role::kView, out[2].eye = "right";
  return out;
}

constexpr std::int64_t kMs = 1'000'000;

capture::Frame frame_of(int camera, double ms) {
  capture::Frame out;
  out.camera = camera;
  out.time = TimestampNs{static_cast<std::int64_t>(ms * double(kMs))};
  return out;
}

std::vector<int> cameras_of(const std::vector<capture::Frame>& frames) {
  std::vector<int> out;
  for (const auto& f : frames) out.push_back(f.camera);
  return out;
}

class ViewMailboxes : public ::testing::Test {
 protected:
  ViewMailbox box_{stereo_cameras(), Seconds(.02)};
  std::vector<capture::Frame> take() { return box_.wait(Seconds(0)); }
};

TEST_F(ViewMailboxes, EyesOfOneMomentComeTogetherLeftFirst) {
  box_.put(frame_of(2, 0));
  EXPECT_FALSE(box_.waiting());
  box_.put(frame_of(0, 3));
  EXPECT_EQ(cameras_of(take()), (std::vector{0, 2}));
  EXPECT_FALSE(box_.waiting());
  EXPECT_EQ(box_.dropped(), 0u);
  EXPECT_EQ(box_.unmatched(), 0u);
}

TEST_F(ViewMailboxes, ANewerPairTakesThePlaceOfAnOlderOneAndNeverHalfOfIt) {
  for (const double ms : {0., 20., 40.}) {
    box_.put(frame_of(0, ms));
    box_.put(frame_of(2, ms + 1));
  }
  box_.put(frame_of(0, 60));  // its other one is still under way
  const auto pair = take();
  ASSERT_EQ(pair.size(), 2u);
  EXPECT_EQ(pair[0].time.value, 40 * kMs);
  EXPECT_EQ(pair[1].time.value, 41 * kMs);
  EXPECT_EQ(box_.dropped(), 4u);
  EXPECT_EQ(box_.unmatched(), 0u);
  box_.put(frame_of(2, 61));
  EXPECT_EQ(take().size(), 2u);
}

TEST_F(ViewMailboxes, AnEyeWithoutTheOtherOneIsCountedAndTheNextPairIsWhole) {
  box_.put(frame_of(0, 0));
  box_.put(frame_of(0, 20));  // the right eye's first frame was lost
  EXPECT_FALSE(box_.waiting());
  box_.put(frame_of(2, 21));
  const auto pair = take();
  ASSERT_EQ(pair.size(), 2u);
  EXPECT_EQ(pair[0].time.value, 20 * kMs);
  EXPECT_EQ(box_.unmatched(), 1u);
  // Out of step by more than half a period: the older one goes.
  box_.put(frame_of(2, 41));
  box_.put(frame_of(0, 60));
  EXPECT_FALSE(box_.waiting());
  box_.put(frame_of(2, 61));
  EXPECT_EQ(take().size(), 2u);
  EXPECT_EQ(box_.unmatched(), 2u);
}

TEST_F(ViewMailboxes, AnEyeWhoseCameraIsGoneGoesOnAlone) {
  box_.put(frame_of(0, 0));
  box_.put(frame_of(2, 1));
  take();
  int alone = 0;
  for (double ms = 20; ms <= 600; ms += 20) {
    box_.put(frame_of(0, ms));
    if (const auto frames = take(); !frames.empty()) {
      EXPECT_EQ(cameras_of(frames), std::vector{0});
      EXPECT_GT(frames[0].time.value, 250 * kMs);
      ++alone;
    }
  }
  EXPECT_GT(alone, 12);
  // It is back.
  box_.put(frame_of(0, 620));
  take();
  box_.put(frame_of(2, 641));
  box_.put(frame_of(0, 640));
  EXPECT_EQ(cameras_of(take()), (std::vector{0, 2}));
}

// A player that loops, a machine that slept.
TEST_F(ViewMailboxes, APauseOfBothEyesTearsNoPair) {
  for (const double start : {0., 900., 2500.})
    for (int n = 0; n < 3; ++n) {
      box_.put(frame_of(0, start + 20 * n));
      box_.put(frame_of(2, start + 20 * n + .3));
      EXPECT_EQ(take().size(), 2u) << start << ' ' << n;
    }
  EXPECT_EQ(box_.unmatched(), 0u);
}

TEST(EyeMoments, BothEyesOfAMomentHaveItsNumberThoughOthersAreMissing) {
  EyeMoments moments(stereo_cameras(), Seconds(.02));
  EXPECT_TRUE(moments.paired());
  std::vector<std::uint64_t> left, right;
  for (int n = 0; n < 6; ++n) {
    if (n != 4) left.push_back(moments.number(frame_of(0, 20 * n)));
    if (n != 1 && n != 2) right.push_back(moments.number(frame_of(2, 20 * n + 3)));
    moments.number(frame_of(1, 20 * n + 5));  // the surroundings have their own
  }
  EXPECT_EQ(left, (std::vector<std::uint64_t>{0, 1, 2, 3, 5}));
  EXPECT_EQ(right, (std::vector<std::uint64_t>{0, 3, 4, 5}));
  EXPECT_EQ(moments.unmatched(), 3u);
}

TEST(EyeMoments, CamerasThatAreNoPairCountTheirOwnFrames) {
  std::vector<capture::CameraInfo> cameras(2);
  for (capture::CameraInfo& c : cameras) c.role = capture::Role::kView;
  EyeMoments moments(cameras, Seconds(0));
  EXPECT_EQ(moments.number(frame_of(0, 0)), 0u);
  EXPECT_EQ(moments.number(frame_of(0, 1)), 1u);
  EXPECT_EQ(moments.number(frame_of(1, 2)), 0u);
  EXPECT_EQ(moments.unmatched(), 0u);
}

TEST_F(ViewMailboxes, CamerasThatAreNoPairGoEachByItself) {
  auto cameras = stereo_cameras();
  cameras[0].eye.clear(), cameras[2].eye.clear();
  ViewMailbox box(cameras, Seconds(.02));
  box.put(frame_of(2, 1));
  box.put(frame_of(0, 0));
  EXPECT_EQ(cameras_of(box.wait(Seconds(0))), std::vector{0});
  EXPECT_EQ(cameras_of(box.wait(Seconds(0))), std::vector{2});
  box.close();
  box.put(frame_of(0, 20));
  EXPECT_TRUE(box.wait(Seconds(0)).empty());
}

}  // namespace
}  // namespace penumbra::runtime
