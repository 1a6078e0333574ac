// Boards drawn by OpenCV, seen in perspective: every corner where it must be.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/calib.h"

namespace penumbra::calib {
namespace {

using testing::HasSubstr;

constexpr int kBoardWidth = 900, kBoardHeight = 700;

struct Seen {
  FramePixels picture;
  cv::Matx33d pixel_from_board;  // continuous pixels from metres
};

// `drawing` shows `size_m` metres of the board from (x0, y0) on.
Seen view(const cv::Mat& drawing, cv::Point2d from_m, cv::Size2d size_m) {
  const std::vector<cv::Point2f> corners{
      {0, 0},
      {static_cast<float>(drawing.cols), 0},
      {static_cast<float>(drawing.cols), static_cast<float>(drawing.rows)},
      {0, static_cast<float>(drawing.rows)}};
  const std::vector<cv::Point2f> seen{{120, 90}, {800, 140}, {770, 640}, {90, 560}};
  const cv::Mat h = cv::getPerspectiveTransform(corners, seen);
  // warpPerspective counts from pixel centres, these corners from borders.
  const cv::Matx33d borders(h), half(1, 0, .5, 0, 1, .5, 0, 0, 1);
  cv::Mat grey;
  cv::warpPerspective(drawing, grey, half.inv() * borders * half, {kBoardWidth, kBoardHeight},
                      cv::INTER_AREA, cv::BORDER_CONSTANT, cv::Scalar(200));
  cv::GaussianBlur(grey, grey, {3, 3}, .7);
  Image<Rgb8> picture(kBoardWidth, kBoardHeight);
  for (int y = 0; y < kBoardHeight; ++y)
    for (int x = 0; x < kBoardWidth; ++x) {
      const auto v = grey.at<std::uint8_t>(y, x);
      picture.at(x, y) = {v, v, v};
    }
  const cv::Matx33d drawing_from_board(
      drawing.cols / size_m.width, 0, -from_m.x * drawing.cols / size_m.width, 0,
      drawing.rows / size_m.height, -from_m.y * drawing.rows / size_m.height, 0, 0, 1);
  return {picture, borders * drawing_from_board};
}

void expect_corners(const Seen& seen, const Board& board, std::size_t count, double tolerance_px) {
  auto found = find_board(seen.picture, board, "view");
  ASSERT_TRUE(found);
  // A plain chessboard looks the same from its other end.
  const cv::Vec3d first =
      seen.pixel_from_board * cv::Vec3d(found->on_board_m[0].x, found->on_board_m[0].y, 1);
  if (board.kind == Board::Kind::kChessboard && found->pixels[0].x > first[0] / first[2] + 50)
    std::ranges::reverse(found->pixels);
  EXPECT_EQ(found->pixels.size(), count);
  for (std::size_t i = 0; i < found->pixels.size(); ++i) {
    const cv::Vec3d p =
        seen.pixel_from_board * cv::Vec3d(found->on_board_m[i].x, found->on_board_m[i].y, 1);
    EXPECT_NEAR(found->pixels[i].x, p[0] / p[2], tolerance_px) << i;
    EXPECT_NEAR(found->pixels[i].y, p[1] / p[2], tolerance_px) << i;
  }
}

TEST(Boards, Chessboard) {
  const auto board = parse_board("chessboard:9x6:0.03");
  ASSERT_TRUE(board);
  constexpr int kSquare = 80;
  cv::Mat drawing(8 * kSquare, 11 * kSquare, CV_8U, cv::Scalar(255));  // with a white border
  for (int y = 0; y < 7; ++y)
    for (int x = 0; x < 10; ++x)
      if ((x + y) % 2 == 0)
        drawing(cv::Rect(x * kSquare + kSquare / 2, y * kSquare + kSquare / 2, kSquare, kSquare)) =
            0;
  // The first inner corner is one and a half squares in.
  expect_corners(view(drawing, {-1.5 * .03, -1.5 * .03}, {11 * .03, 8 * .03}), *board, 54, .15);
}

TEST(Boards, Charuco) {
  const auto board = parse_board("charuco:8x6:0.04:0.03");
  ASSERT_TRUE(board);
  const auto drawn = cv::aruco::CharucoBoard::create(
      8, 6, .04f, .03f, cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50));
  cv::Mat drawing;
  drawn->draw({960, 720}, drawing);
  const Seen seen = view(drawing, {-.04, -.04}, {8 * .04, 6 * .04});
  expect_corners(seen, *board, 35, .2);
  // Half of it out of the picture: the rest is known by its markers.
  Seen part = seen;
  auto& picture = std::get<Image<Rgb8>>(part.picture);
  for (int y = 0; y < kBoardHeight; ++y)
    for (int x = 0; x < kBoardWidth / 2; ++x) picture.at(x, y) = {90, 90, 90};
  const auto found = find_board(part.picture, *board, "part");
  ASSERT_TRUE(found);
  EXPECT_GE(found->pixels.size(), 10u);
  EXPECT_LE(found->pixels.size(), 20u);
}

TEST(Boards, AprilTags) {
  const auto board = parse_board("apriltag:5x4:0.05:0.015");
  ASSERT_TRUE(board);
  const auto tags = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
  constexpr int kMargin = 40, kTag = 160, kGap = 48;
  constexpr double kScale = kTag / .05;
  cv::Mat drawing(4 * kTag + 3 * kGap + 2 * kMargin, 5 * kTag + 4 * kGap + 2 * kMargin, CV_8U,
                  cv::Scalar(255));
  for (int id = 0; id < 20; ++id) {
    cv::Mat tag;
    cv::aruco::drawMarker(tags, id, kTag, tag);
    tag.copyTo(drawing(
        cv::Rect(kMargin + id % 5 * (kTag + kGap), kMargin + id / 5 * (kTag + kGap), kTag, kTag)));
  }
  expect_corners(view(drawing, {-kMargin / kScale, -kMargin / kScale},
                      {drawing.cols / kScale, drawing.rows / kScale}),
                 *board, 80,
                 .5);  // a corner of black against white is found less well than four squares
}

TEST(Boards, NothingWhereThereIsNone) {
  const FramePixels grey = Image<Rgb8>(200, 150, {128, 128, 128});
  for (const char* text :
       {"chessboard:9x6:0.03", "charuco:8x6:0.04:0.03", "apriltag:5x4:0.05:0.015"})
    EXPECT_FALSE(find_board(grey, *parse_board(text), "grey")) << text;
  EXPECT_FALSE(find_board(Image<Rgb16>(3, 2), *parse_board("chessboard:9x6:0.03"), "tiny"));
}

TEST(Boards, TextsThatAreNoBoardAreRefused) {
  for (const char* text :
       {"", "circles:4x5:1", "chessboard:9x6", "charuco:8x6:0.04", "chessboard:9x6:0.03:1"})
    EXPECT_THAT(parse_board(text).error().detail, HasSubstr("expected chessboard:")) << text;
  EXPECT_THAT(parse_board("chessboard:9:0.03").error().detail, HasSubstr("2..100"));
  EXPECT_THAT(parse_board("chessboard:9x1:0.03").error().detail, HasSubstr("2..100"));
  EXPECT_THAT(parse_board("chessboard:9x2:0.03").error().detail, HasSubstr("3x3"));
  EXPECT_THAT(parse_board("chessboard:9x6:-1").error().detail, HasSubstr("metres"));
  EXPECT_THAT(parse_board("chessboard:9x6:nan").error().detail, HasSubstr("metres"));
  EXPECT_THAT(parse_board("charuco:20x20:0.04:0.03").error().detail, HasSubstr("50 markers"));
  EXPECT_THAT(parse_board("charuco:8x6:0.03:0.04").error().detail, HasSubstr("not smaller"));
}

}  // namespace
}  // namespace penumbra::calib
