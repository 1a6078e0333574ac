// Pages of boards, read back by a reader of their rectangles alone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <sstream>
#include <vector>

#include "calib/calib.h"
#include "calib/track/board_pdf.h"

namespace penumbra::calib {
namespace {

using testing::HasSubstr;

struct PdfRectangle {
  double x, y, width, height;  // points
};
struct PdfPage {
  double width = 0, height = 0;                   // points
  std::vector<std::vector<PdfRectangle>> shapes;  // rectangles of each fill
  std::string words;
};

// Numbers, then an operator: re collects, f fills, cm scales.
PdfPage read_page(const std::string& pdf) {
  PdfPage out;
  const auto box = pdf.find("/MediaBox [0 0 ");
  std::istringstream(pdf.substr(box + 15)) >> out.width >> out.height;
  const auto begin = pdf.find("stream\n") + 7, end = pdf.find("endstream");
  std::istringstream stream(pdf.substr(begin, end - begin));
  std::vector<double> numbers;
  std::vector<PdfRectangle> path;
  double scale = 1;
  for (std::string word; stream >> word;) {
    double value = 0;
    if (std::istringstream number(word); number >> value && number.eof()) {
      numbers.push_back(value);
      continue;
    }
    const std::size_t n = numbers.size();
    if (word == "cm")
      scale *= numbers[n - 6];
    else if (word == "re")
      path.push_back({scale * numbers[n - 4], scale * numbers[n - 3], scale * numbers[n - 2],
                      scale * numbers[n - 1]});
    else if (word == "f")
      out.shapes.push_back(std::exchange(path, {}));
    else if (word[0] == '(')
      out.words += word + " ";
    numbers.clear();
  }
  return out;
}

FramePixels rasterise(const PdfPage& page, double pixels_per_point) {
  const auto px = [&](double v) { return static_cast<int>(std::lround(v * pixels_per_point)); };
  Image<Rgb8> out(px(page.width), px(page.height), {255, 255, 255});
  for (const auto& shape : page.shapes)
    for (const PdfRectangle& r : shape)
      for (int y = px(page.height - r.y - r.height); y < px(page.height - r.y); ++y)
        for (int x = px(r.x); x < px(r.x + r.width); ++x) out.at(x, y) = {0, 0, 0};
  return out;
}

constexpr double kPointsPerMetre = 72 / .0254;

class PdfOfBoard : public testing::TestWithParam<std::pair<const char*, Paper>> {};

TEST_P(PdfOfBoard, HasAllCornersInTrueSize) {
  const auto [text, paper] = GetParam();
  const Board board = *parse_board(text);
  const auto pdf = board_pdf(board, paper);
  ASSERT_TRUE(pdf) << pdf.error().detail;
  EXPECT_TRUE(pdf->starts_with("%PDF-1.4\n"));
  EXPECT_TRUE(pdf->ends_with("%%EOF\n"));
  const PdfPage page = read_page(*pdf);
  constexpr double kPixels = 200 / 72.;  // a point
  const auto found = find_board(rasterise(page, kPixels), board, "page");
  ASSERT_TRUE(found);
  const int expected = board.kind == Board::Kind::kCharuco ? (board.columns - 1) * (board.rows - 1)
                                                           : 4 * board.columns * board.rows;
  std::set<std::pair<double, double>> all;  // the detector may see a tag twice
  for (const glm::dvec2& p : found->on_board_m) all.emplace(p.x, p.y);
  ASSERT_EQ(std::ssize(all), expected);
  // All corners against the first, upright and in metres.
  for (std::size_t i = 0; i < found->pixels.size(); ++i) {
    const glm::dvec2 seen = (found->pixels[i] - found->pixels[0]) / (kPixels * kPointsPerMetre),
                     told = found->on_board_m[i] - found->on_board_m[0];
    EXPECT_NEAR(seen.x, told.x, 2e-4) << i;
    EXPECT_NEAR(seen.y, told.y, 2e-4) << i;
  }
}

TEST_P(PdfOfBoard, HasARulerOfAHundredMillimetres) {
  const auto [text, paper] = GetParam();
  const PdfPage page = read_page(*board_pdf(*parse_board(text), paper));
  ASSERT_EQ(page.shapes.size(), 2u);
  double left = 1e9, right = 0;
  for (const PdfRectangle& r : page.shapes[1])
    left = std::min(left, r.x), right = std::max(right, r.x + r.width);
  EXPECT_NEAR((right - left) / kPointsPerMetre, .1, 1e-6);
  // Nothing leaves the page or is printed over the board.
  double lowest = 1e9;
  for (const PdfRectangle& r : page.shapes[0]) lowest = std::min(lowest, r.y);
  for (const auto& shape : page.shapes)
    for (const PdfRectangle& r : shape) {
      EXPECT_GE(r.x, 0);
      EXPECT_GE(r.y, 0);
      EXPECT_LE(r.x + r.width, page.width);
      EXPECT_LE(r.y + r.height, page.height);
    }
  for (const PdfRectangle& r : page.shapes[1]) EXPECT_LT(r.y + r.height, lowest);
}

TEST_P(PdfOfBoard, SaysTheBoardAsItIsRead) {
  const auto [text, paper] = GetParam();
  const Board board = *parse_board(text);
  EXPECT_EQ(board_text(board), text);
  EXPECT_THAT(*board_pdf(board, paper), HasSubstr(std::string("(--board ") + text + ")"));
}

INSTANTIATE_TEST_SUITE_P(All, PdfOfBoard,
                         testing::Values(std::pair("charuco:8x6:0.03:0.022", Paper::kA4),
                                         std::pair("charuco:8x6:0.03:0.022", Paper::kLetter),
                                         std::pair("charuco:5x8:0.03:0.022:24", Paper::kA4),
                                         std::pair("apriltag:5x4:0.036:0.012", Paper::kA4),
                                         std::pair("apriltag:4x5:0.03:0.01:40", Paper::kLetter)));

TEST(BoardPdf, TheTableSaysWhereEachObjectBegins) {
  const std::string pdf = *board_pdf(*parse_board("charuco:8x6:0.03:0.022"), Paper::kA4);
  const std::size_t table = std::stoul(pdf.substr(pdf.find("startxref\n") + 10));
  EXPECT_EQ(pdf.substr(table, 5), "xref\n");
  std::istringstream rows(pdf.substr(table + 5));
  std::string line;
  std::getline(rows, line);
  std::getline(rows, line);
  for (int object = 1; object <= 5; ++object) {
    std::getline(rows, line);
    EXPECT_EQ(line.size(), 19u);  // and the end of line: twenty bytes
    const std::string start = std::to_string(object) + " 0 obj";
    EXPECT_EQ(pdf.substr(std::stoul(line), start.size()), start);
  }
  const std::size_t length = std::stoul(pdf.substr(pdf.find("/Length ") + 8));
  EXPECT_EQ(pdf.substr(pdf.find("stream\n") + 7 + length, 9), "endstream");
}

TEST(BoardPdf, WhatDoesNotFitThePaperIsRefused) {
  const auto refused = board_pdf(*parse_board("charuco:8x6:0.04:0.03"), Paper::kA4);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().detail, HasSubstr("320 x 240 mm"));
  EXPECT_THAT(refused.error().detail, HasSubstr("does not fit A4"));
  EXPECT_FALSE(parse_paper("a3"));
  EXPECT_EQ(*parse_paper("letter"), Paper::kLetter);
}

TEST(Boards, TheFirstMarkersIdTellsTwoBoardsApart) {
  const Board second = *parse_board("charuco:8x6:0.03:0.022:24");
  EXPECT_EQ(second.first_id, 24);
  EXPECT_EQ(marker_count(second), 24);
  EXPECT_EQ(parse_board("charuco:8x6:0.03:0.022")->first_id, 0);
  EXPECT_THAT(parse_board("charuco:8x6:0.03:0.022:27").error().detail, HasSubstr("0..26"));
  EXPECT_THAT(parse_board("charuco:8x6:0.03:0.022:x").error().detail, HasSubstr("0..26"));
  EXPECT_THAT(parse_board("apriltag:30x30:0.03:0.01").error().detail, HasSubstr("587"));
  EXPECT_FALSE(parse_board("chessboard:9x6:0.03:0.01:4"));
}

}  // namespace
}  // namespace penumbra::calib
