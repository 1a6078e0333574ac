// Rendered boards, whose camera's place is known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "calib/calib.h"
#include "calib/track/board_tracker.h"
#include "core/io/log.h"
#include "tests/support/board_pictures.h"

namespace penumbra::calib {
namespace {

using test::BoardPainter;
using test::DrawnBoard;
using test::looking_at;
using testing::HasSubstr;

constexpr double kDegrees = kPi / 180;

CameraModel lens_of(ProjectionKind kind, int width = 640, int height = 480, double focal = 520) {
  CameraModel out = *make_projection(kind, width, height);
  out.focal_px = glm::dvec2(focal, focal * 1.002);
  out.principal_px = {width / 2. + 3.2, height / 2. - 2.1};
  switch (kind) {
    case ProjectionKind::kPinhole:
      return *with_distortion(out, std::vector{-.12, .05, .0008, -.0005, 0.});
    case ProjectionKind::kKannalaBrandt:
      return *with_distortion(out, std::vector{.03, -.01, .002, 0.});
    case ProjectionKind::kDoubleSphere:
      return *with_distortion(out, std::vector{-.1, .55});
    default:
      return out;
  }
}

Board board_of(const char* text) {
  return *parse_board(text);
}
const char* const kCharuco = "charuco:8x6:0.03:0.022";
const char* const kTags = "apriltag:5x4:0.036:0.012";

TimestampNs frame_time(int i) {
  return {1'000'000'000 + i * 33'333'333LL};
}

// A camera that hangs over the middle of a board on the floor and looks at it from the side.
Pose over(const DrawnBoard& board, double distance_m, double tilt, double round, double roll = 0) {
  const glm::dvec2 at = board.from_m + .5 * board.size_m;
  const glm::dvec3 middle = board.world_from_board * glm::dvec3(at.x, -at.y, 0);
  return looking_at(
      middle + distance_m * glm::dvec3(std::sin(tilt) * std::sin(round), std::cos(tilt),
                                       std::sin(tilt) * std::cos(round)),
      middle, roll);
}

struct PoseError {
  double degrees, relative;
};
PoseError error_of(const TrackedPose& found, const Pose& truth, double distance_m) {
  const glm::dquat d = found.world_from_camera.rotation * glm::conjugate(truth.rotation);
  return {2 * std::asin(std::min(1., glm::length(glm::dvec3(d.x, d.y, d.z)))) / kDegrees,
          glm::length(found.world_from_camera.translation - truth.translation) / distance_m};
}

class TrackerOfLens : public testing::TestWithParam<ProjectionKind> {};

TEST_P(TrackerOfLens, FindsTheCameraNearAndFar) {
  const CameraModel lens = lens_of(GetParam());
  const BoardPainter painter(lens);
  double worst_degrees = 0, worst_place = 0;
  for (const char* text : {kCharuco, kTags}) {
    const Board board = board_of(text);
    const Pose floor = world_from_flat_board(board);
    const DrawnBoard drawn = test::draw_board(board, floor);
    // The farthest is as 2 m before a camera of 1280 x 720 with a focal length of 900 pixels.
    for (const double distance : {.4, .7, 1.15}) {
      auto tracker = BoardTracker::create({{board, floor}}, lens);
      ASSERT_TRUE(tracker);
      const Pose truth = over(drawn, distance, 38 * kDegrees, .7, .2);
      int poses = 0;
      double degrees = 0, place = 0;
      for (int i = 0; i < 6; ++i) {
        const auto found = tracker->track(
            painter.paint({drawn}, truth, {.seed = static_cast<unsigned>(i)}), frame_time(i));
        if (!found) continue;
        ++poses;
        const PoseError e = error_of(*found, truth, distance);
        EXPECT_LT(e.degrees, .25) << text << " at " << distance;
        EXPECT_LT(e.relative, .004) << text << " at " << distance;
        EXPECT_LT(found->rms_px, .25);
        degrees += e.degrees, place += e.relative;
      }
      ASSERT_GE(poses, 5) << text << " at " << distance;  // far away the second search finds it
      EXPECT_LE(tracker->counts().searched, 2u) << text << " at " << distance;
      EXPECT_LT(degrees / poses, .2) << text << " at " << distance;
      EXPECT_LT(place / poses, .003) << text << " at " << distance;
      worst_degrees = std::max(worst_degrees, degrees / poses);
      worst_place = std::max(worst_place, place / poses);
    }
  }
  std::printf("%s: worst %.3f degrees, %.4f of the distance\n",
              std::string(projection_name(GetParam())).c_str(), worst_degrees, worst_place);
}

INSTANTIATE_TEST_SUITE_P(All, TrackerOfLens,
                         testing::Values(ProjectionKind::kPinhole, ProjectionKind::kKannalaBrandt,
                                         ProjectionKind::kDoubleSphere,
                                         ProjectionKind::kEquidistant),
                         [](const auto& param) {
                           std::string name(projection_name(param.param));
                           std::erase(name, '-');
                           return name;
                         });

TEST(BoardTracker, FindsALargeBoardAtTwoMetres) {
  const CameraModel lens = lens_of(ProjectionKind::kPinhole, 1280, 720, 900);
  const BoardPainter painter(lens);
  const Board board = board_of("charuco:8x6:0.05:0.0375");
  const Pose floor = world_from_flat_board(board);
  const DrawnBoard drawn = test::draw_board(board, floor);
  auto tracker = BoardTracker::create({{board, floor}}, lens);
  for (const double round : {0., 2.}) {
    const Pose truth = over(drawn, 2, 40 * kDegrees, round);
    const auto found =
        tracker->track(painter.paint({drawn}, truth), frame_time(round > 0 ? 90 : 0));
    ASSERT_TRUE(found);
    EXPECT_LT(error_of(*found, truth, 2).degrees, .2);
    EXPECT_LT(error_of(*found, truth, 2).relative, .003);
  }
}

// From the first pictures on, while nothing tells the motion yet: corners that are searched for
// some pixels off find their neighbours' edges, and those agree on a pose that lags behind.
TEST(BoardTracker, FollowsACameraThatMovesFromTheFirstPictureOn) {
  const CameraModel lens = lens_of(ProjectionKind::kPinhole, 1280, 720, 905);
  const BoardPainter painter(lens);
  for (const char* text : {"apriltag:4x3:0.05:0.015", kCharuco}) {
    const Board board = board_of(text);
    const Pose floor = world_from_flat_board(board);
    const DrawnBoard drawn = test::draw_board(board, floor);
    for (const double start : {0., 1.9, 4.1}) {
      auto tracker = BoardTracker::create({{board, floor}}, lens);
      double degrees = 0, place = 0;
      constexpr int kPictures = 6;
      for (int i = 0; i < kPictures; ++i) {
        const double distance = 1.33 + .03 * i;
        const Pose truth = over(drawn, distance, (38 + .8 * i) * kDegrees, start + .045 * i, .1);
        const auto found = tracker->track(
            painter.paint({drawn}, truth, {.seed = static_cast<unsigned>(i)}), frame_time(i));
        ASSERT_TRUE(found) << text << ' ' << start << ' ' << i;
        const PoseError e = error_of(*found, truth, distance);
        EXPECT_LT(e.degrees, .3) << text << ' ' << start << ' ' << i;
        EXPECT_LT(e.relative, .0045) << text << ' ' << start << ' ' << i;
        degrees += e.degrees / kPictures, place += e.relative / kPictures;
      }
      std::printf("%s from %.1f: %.3f degrees, %.4f of the distance in the mean\n", text, start,
                  degrees, place);
      EXPECT_LT(degrees, .2);
      EXPECT_LT(place, .003);
    }
  }
}

TEST(BoardTracker, StaysNearTheLastPlaceWhileTheCameraTurnsFast) {
  const CameraModel lens = lens_of(ProjectionKind::kPinhole);
  const BoardPainter painter(lens);
  const Board board = board_of(kCharuco);
  const Pose floor = world_from_flat_board(board);
  const DrawnBoard drawn = test::draw_board(board, floor);
  auto tracker = BoardTracker::create({{board, floor}}, lens);
  constexpr int kPictures = 12;
  for (int i = 0; i < kPictures; ++i) {
    const Pose truth = over(drawn, .6, (25 + .5 * i) * kDegrees, .05 * i, .058 * i);  // 100 deg/s
    const auto found = tracker->track(painter.paint({drawn}, truth), frame_time(i));
    ASSERT_TRUE(found) << i;
    EXPECT_LT(error_of(*found, truth, .6).degrees, .2) << i;
  }
  EXPECT_EQ(tracker->counts().near + tracker->counts().searched, 12u);
  EXPECT_LE(tracker->counts().searched, 3u);
}

TEST(BoardTracker, LosesABoardThatIsCoveredAndFindsItAgain) {
  const CameraModel lens = lens_of(ProjectionKind::kPinhole);
  const BoardPainter painter(lens);
  const Board board = board_of(kCharuco);
  const Pose floor = world_from_flat_board(board);
  const DrawnBoard drawn = test::draw_board(board, floor);
  auto tracker = BoardTracker::create({{board, floor}}, lens);
  const Pose truth = over(drawn, .6, .5, .3), elsewhere = over(drawn, .7, .7, 2.3);
  ASSERT_TRUE(tracker->track(painter.paint({drawn}, truth), frame_time(0)));
  test::PictureFaults half{.covered = {0, 0, 320, 480}}, all{.covered = {0, 0, 640, 480}};
  const auto part = tracker->track(painter.paint({drawn}, truth, half), frame_time(1));
  ASSERT_TRUE(part);
  EXPECT_FALSE(part->searched);
  EXPECT_LT(part->corners, 25);
  EXPECT_LT(error_of(*part, truth, .6).degrees, .3);
  for (int i = 2; i < 12; ++i)
    EXPECT_FALSE(tracker->track(painter.paint({drawn}, truth, all), frame_time(i)));
  const auto again = tracker->track(painter.paint({drawn}, elsewhere), frame_time(12));
  ASSERT_TRUE(again);
  EXPECT_TRUE(again->searched);
  EXPECT_LT(error_of(*again, elsewhere, .7).degrees, .2);
}

TEST(BoardTracker, DoesNotTakeAShiftedBoardForItself) {
  const CameraModel lens = lens_of(ProjectionKind::kPinhole);
  const BoardPainter painter(lens);
  const Board board = board_of(kCharuco);
  const Pose floor = world_from_flat_board(board);
  const DrawnBoard drawn = test::draw_board(board, floor);
  auto tracker = BoardTracker::create({{board, floor}}, lens);
  Pose pose = over(drawn, .6, .4, 0);
  ASSERT_TRUE(tracker->track(painter.paint({drawn}, pose), frame_time(0)));
  // By one square to the right and one down all corners fall on corners of the same colours.
  pose.translation += floor.rotation * glm::dvec3(.03, -.03, 0);
  const auto found = tracker->track(painter.paint({drawn}, pose), frame_time(1));
  ASSERT_TRUE(found);
  EXPECT_LT(error_of(*found, pose, .6).relative, .003);
}

TEST(BoardTracker, SeesTwoBoardsAsOneWorld) {
  const CameraModel lens = lens_of(ProjectionKind::kKannalaBrandt);
  const BoardPainter painter(lens);
  const Board one = board_of(kCharuco), two = board_of("charuco:8x6:0.03:0.022:24");
  const Pose floor = world_from_flat_board(one);
  const Pose wall{{1, 0, 0, 0}, {0, .3, -.25}};
  const DrawnBoard first = test::draw_board(one, floor), second = test::draw_board(two, wall);
  auto tracker = BoardTracker::create({{one, floor}, {two, wall}}, lens);
  const Pose truth = looking_at({.25, .5, .6}, {.1, .08, 0});
  const auto both = tracker->track(painter.paint({first, second}, truth), frame_time(0));
  ASSERT_TRUE(both);
  EXPECT_GT(both->corners, 45);
  EXPECT_LT(error_of(*both, truth, .8).degrees, .1);
  EXPECT_LT(error_of(*both, truth, .8).relative, .002);
  EXPECT_EQ(tracker->trouble(), "");
  // One of them is enough.
  const auto other = tracker->track(painter.paint({second}, truth), frame_time(1));
  ASSERT_TRUE(other);
  EXPECT_LT(error_of(*other, truth, .8).degrees, .5);
}

TEST(BoardTracker, SaysThatAWrongSizeContradictsAnotherBoard) {
  std::vector<std::string> lines;
  set_log_sink([&](LogLevel, std::string_view line) { lines.emplace_back(line); });
  const CameraModel lens = lens_of(ProjectionKind::kPinhole);
  const BoardPainter painter(lens);
  const Board one = board_of(kCharuco), two = board_of("charuco:8x6:0.03:0.022:24"),
              wrong = board_of("charuco:8x6:0.0312:0.02288:24");  // 4 % larger than it is
  const Pose floor = world_from_flat_board(one), beside{floor.rotation, {.3, 0, .1}};
  const DrawnBoard first = test::draw_board(one, floor), second = test::draw_board(two, beside);
  auto right = BoardTracker::create({{one, floor}, {two, beside}}, lens);
  auto told_wrong = BoardTracker::create({{one, floor}, {wrong, beside}}, lens);
  const Pose truth = looking_at({.3, .6, .55}, {.25, 0, .08});
  for (int i = 0; i < 3; ++i) {
    const FramePixels picture = painter.paint({first, second}, truth, {.seed = 7u + i});
    ASSERT_TRUE(right->track(picture, frame_time(40 * i)));
    const auto found = told_wrong->track(picture, frame_time(40 * i));
    ASSERT_TRUE(found);
    EXPECT_LT(error_of(*found, truth, .8).degrees, .2);  // by the first board
    EXPECT_LT(error_of(*found, truth, .8).relative, .003);
  }
  set_log_sink({});
  EXPECT_EQ(right->trouble(), "");
  EXPECT_THAT(told_wrong->trouble(), HasSubstr("boards 1 and 2 contradict each other"));
  ASSERT_EQ(lines.size(), 1u);  // once
  EXPECT_THAT(lines[0], HasSubstr("as told"));
}

// From sixty metres through a long lens a board looks nearly alike from two sides.
constexpr double kFar_m = 60;
CameraModel long_lens() {
  CameraModel out = *make_projection(ProjectionKind::kPinhole, 640, 480);
  out.focal_px = {45000, 45000};
  return out;
}

TEST(BoardTracker, ReportsNothingRatherThanTheWrongLean) {
  const BoardPainter painter(long_lens());
  const Board board = board_of("charuco:5x4:0.05:0.0375");
  const Pose floor = world_from_flat_board(board);
  const DrawnBoard drawn = test::draw_board(board, floor);
  std::uint64_t undecided = 0;
  for (int i = 0; i < 10; ++i) {
    auto tracker = BoardTracker::create({{board, floor}}, long_lens());
    const Pose truth = over(drawn, kFar_m, 28 * kDegrees, .6 * i);
    const auto found = tracker->track(
        painter.paint({drawn}, truth, {.noise = 4, .seed = static_cast<unsigned>(i)}),
        frame_time(0));
    undecided += tracker->counts().undecided;
    if (!found) continue;
    EXPECT_LT(error_of(*found, truth, kFar_m).degrees, 10) << i;
  }
  EXPECT_GE(undecided, 8u);
}

TEST(BoardTracker, ThePicturesBeforeTellTheLean) {
  const BoardPainter painter(long_lens());
  const Board board = board_of("charuco:5x4:0.05:0.0375"),
              other = board_of("charuco:5x4:0.05:0.0375:10");
  const Pose floor = world_from_flat_board(board), wall{{1, 0, 0, 0}, {0, .16, -.12}};
  const DrawnBoard first = test::draw_board(board, floor), second = test::draw_board(other, wall);
  for (int i = 0; i < 4; ++i) {
    auto tracker = BoardTracker::create({{board, floor}, {other, wall}}, long_lens());
    const Pose truth = looking_at({3 - 1.5 * i, 36, 48}, {.08, .05, 0});
    ASSERT_TRUE(tracker->track(painter.paint({first, second}, truth), frame_time(0)));
    const auto alone = tracker->track(painter.paint({first}, truth), frame_time(1));
    ASSERT_TRUE(alone) << i;
    EXPECT_LT(error_of(*alone, truth, kFar_m).degrees, 5) << i;
  }
}

TEST(BoardTracker, RefusesWhatItCannotTellApart) {
  const CameraModel lens = lens_of(ProjectionKind::kPinhole);
  const Board board = board_of(kCharuco);
  const auto why = [&](std::vector<PlacedBoard> boards, const CameraModel& camera) {
    const auto tracker = BoardTracker::create(std::move(boards), camera);
    return tracker ? std::string() : tracker.error().where + ": " + tracker.error().detail;
  };
  EXPECT_EQ(why({{board, {}}}, lens), "");
  EXPECT_THAT(why({}, lens), HasSubstr("no board"));
  EXPECT_THAT(why({{board, {}}, {board, {}}}, lens), HasSubstr("board 2: has markers that"));
  EXPECT_THAT(why({{board_of("chessboard:9x6:0.03"), {}}}, lens), HasSubstr("chessboard"));
  EXPECT_THAT(why({{board, Pose{{1, 0, 0, 0}, {NAN, 0, 0}}}}, lens), HasSubstr("not finite"));
  EXPECT_THAT(why({{board, {}}}, *make_projection(ProjectionKind::kLatLong, 64, 32)),
              HasSubstr("latlong has none"));
}

TEST(BoardTracker, AFlatBoardHasTheWorldsUpOutOfThePaper) {
  const Board board = board_of(kCharuco);
  const Pose floor = world_from_flat_board(board);
  const auto near = [](const glm::dvec3& a, const glm::dvec3& b) {
    return glm::length(a - b) < 1e-12;
  };
  EXPECT_TRUE(near(floor * glm::dvec3(0, 0, 1), {0, 1, 0}));
  EXPECT_TRUE(near(floor * glm::dvec3(1, 0, 0), {1, 0, 0}));
  EXPECT_TRUE(near(floor * glm::dvec3(0, -1, 0), {0, 0, 1}));  // down the paper
  // 8 x 6 squares of 30 mm: from the first inner corner the middle is 3 right and 2 down.
  const Pose middle = world_from_flat_board(board, BoardOrigin::kMiddle);
  EXPECT_TRUE(near(middle * glm::dvec3(.09, -.06, 0), {0, 0, 0}));
}

}  // namespace
}  // namespace penumbra::calib
