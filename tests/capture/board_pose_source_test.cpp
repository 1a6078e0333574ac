// Frames of a rig whose view camera sees a board.
#include <gtest/gtest.h>

#include "capture/poses/board_pose_source.h"
#include "capture/poses/posed_source.h"
#include "tests/support/board_pictures.h"

namespace penumbra::capture {
namespace {

constexpr double kBoardFps = 30;

struct BoardScene {
  calib::Board board = *calib::parse_board("charuco:8x6:0.03:0.022");
  Pose floor = calib::world_from_flat_board(board);
  calib::CameraModel lens = [] {
    calib::CameraModel out = *calib::make_projection(calib::ProjectionKind::kPinhole, 640, 480);
    out.focal_px = {520, 520};
    return out;
  }();
  test::BoardPainter painter{lens};

  static Pose camera_at(double t) {
    return test::looking_at({.09 + .15 * t, .45, .4}, {.09 + .1 * t, 0, .06});
  }
  Frame frame(int i, bool covered = false) const {
    Frame out;
    out.camera = 0;
    out.sequence = static_cast<std::uint64_t>(i);
    out.time = TimestampNs{3'000'000'000} + Seconds(i / kBoardFps);
    test::PictureFaults faults;
    faults.seed = static_cast<unsigned>(i);
    if (covered) faults.covered = {0, 0, 640, 480};
    out.pixels = std::make_shared<FramePixels>(
        painter.paint({test::draw_board(board, floor)}, camera_at(i / kBoardFps), faults));
    return out;
  }
};

double apart(const FramePose& found, const Pose& truth) {
  return glm::length(found.pose.translation - truth.translation);
}

TEST(BoardPoseSource, FollowsTheCameraThatSeesTheBoard) {
  const BoardScene scene;
  auto source = BoardPoseSource::create({{scene.board, scene.floor}}, scene.lens, {});
  ASSERT_TRUE(source);
  EXPECT_NE((*source)->state().trouble, "");
  for (int i = 0; i < 20; ++i) {
    const auto pose = (*source)->pose_of(scene.frame(i));
    ASSERT_TRUE(pose) << i;
    EXPECT_LT(apart(*pose, BoardScene::camera_at(i / kBoardFps)), .002) << i;
    EXPECT_GT(pose->sigma_m, 0);
    EXPECT_LT(pose->sigma_m, .002);
  }
  EXPECT_EQ((*source)->state().trouble, "");
  EXPECT_EQ((*source)->state().taken, 20u);
}

TEST(BoardPoseSource, TellsOtherCamerasThePoseBetweenTwoPictures) {
  const BoardScene scene;
  auto source = BoardPoseSource::create({{scene.board, scene.floor}}, scene.lens, {});
  ASSERT_TRUE(source);
  for (int i = 0; i < 8; ++i) ASSERT_TRUE((*source)->pose_of(scene.frame(i)));
  Frame other;
  other.camera = 1;
  other.time = TimestampNs{3'000'000'000} + Seconds(6.5 / kBoardFps);
  auto pose = (*source)->pose_of(other);
  ASSERT_TRUE(pose);
  EXPECT_LT(apart(*pose, BoardScene::camera_at(6.5 / kBoardFps)), .002);
  other.time = TimestampNs{3'000'000'000} + Seconds(7.8 / kBoardFps);
  pose = (*source)->pose_of(other);
  ASSERT_TRUE(pose);
  EXPECT_LT(apart(*pose, BoardScene::camera_at(7.8 / kBoardFps)), .004);
  EXPECT_GT(pose->extrapolated.count(), 0);
  other.time = TimestampNs{3'000'000'000} + Seconds(9.5 / kBoardFps);
  EXPECT_FALSE((*source)->pose_of(other));
}

TEST(BoardPoseSource, SaysThatNoBoardIsSeen) {
  const BoardScene scene;
  auto source = BoardPoseSource::create({{scene.board, scene.floor}}, scene.lens, {});
  ASSERT_TRUE(source);
  ASSERT_TRUE((*source)->pose_of(scene.frame(0)));
  EXPECT_TRUE((*source)->pose_of(scene.frame(1, true)));  // one period is bridged
  for (int i = 2; i < 6; ++i) EXPECT_FALSE((*source)->pose_of(scene.frame(i, true)));
  EXPECT_EQ((*source)->state().trouble, "no board is seen");
  EXPECT_NEAR((*source)->state().age->count(), 5 / kBoardFps, 1e-6);
  for (int i = 6; i < 8; ++i) EXPECT_TRUE((*source)->pose_of(scene.frame(i))) << i;
}

}  // namespace
}  // namespace penumbra::capture
