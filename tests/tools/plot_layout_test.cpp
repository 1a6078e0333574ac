#include "tools/chart/plot_layout.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace penumbra::tools {

namespace {

bool overlap(const PlotBox& a, const PlotBox& b) {
  return a.x0 < b.x1 && b.x0 < a.x1 && a.y0 < b.y1 && b.y0 < a.y1;
}

TEST(PlotAxis, HasRoomForAllFiniteValues) {
  const std::vector<double> values{.02, 7, std::nan(""), HUGE_VAL};
  const PlotAxis axis = make_axis(values);
  EXPECT_LT(axis.low, .02);
  EXPECT_GT(axis.high, 7);
  EXPECT_LT(axis.high, 20);
  EXPECT_EQ(axis.zero, 0);
}

TEST(PlotAxis, ZeroStandsBelowAllElseOnItsOwnTick) {
  const std::vector<double> values{.02, 0, 7};
  const PlotAxis axis = make_axis(values);
  EXPECT_GT(axis.fraction(0), 0);
  EXPECT_LT(axis.fraction(0), axis.fraction(axis.end_of_zero()));
  EXPECT_LT(axis.fraction(axis.end_of_zero()), axis.fraction(.02));
  EXPECT_LT(axis.fraction(7), 1);
  EXPECT_NE(axis_ticks(axis, true).find("'0' "), std::string::npos);
  EXPECT_EQ(axis_ticks(make_axis(std::vector{.02, 7.}), true).find("'0' "), std::string::npos);
}

TEST(PlotAxis, ExistsForNoValuesForZerosAloneAndForOneValue) {
  for (const std::vector<double>& values : {std::vector<double>{}, {0, 0}, {3}}) {
    const PlotAxis axis = make_axis(values);
    EXPECT_GT(axis.low, 0);
    EXPECT_GT(axis.high, axis.low);
    for (const double v : values) {
      EXPECT_GT(axis.fraction(v), 0);
      EXPECT_LT(axis.fraction(v), 1);
    }
  }
}

TEST(PlotAxis, ShortRangesHaveLabelsToo) {
  const std::string ticks = axis_ticks(make_axis(std::vector{.015, .07}), true);
  for (const char* label : {"'0.02'", "'0.03'", "'0.05'"})
    EXPECT_NE(ticks.find(label), std::string::npos) << ticks;
  EXPECT_EQ(axis_ticks(make_axis(std::vector{.015, .07}), false).find("0.02'"), std::string::npos);
  const std::string wide = axis_ticks(make_axis(std::vector{.001, 90.}), true);
  EXPECT_EQ(wide.find("'0.02'"), std::string::npos) << wide;
  EXPECT_NE(wide.find("'0.1'"), std::string::npos) << wide;
}

TEST(PlaceLabels, CoverNeitherMarkersNorEachOtherAndStayInside) {
  const PlotBox area{0, 0, 600, 300};
  std::vector<PlotMarker> markers;
  std::vector<WantedLabel> wanted;
  for (int i = 0; i < 40; ++i) {
    const PlotPosition at{20 + 15. * (i * 7 % 38), 15 + 13. * (i * 5 % 21)};
    markers.push_back({at, 14});
    wanted.push_back({at, 60, 15});
  }
  const auto boxes = place_labels(area, wanted, markers, {});
  int placed = 0;
  for (std::size_t i = 0; i < boxes.size(); ++i) {
    if (!boxes[i]) continue;
    ++placed;
    EXPECT_TRUE(boxes[i]->x0 >= 0 && boxes[i]->x1 <= 600 && boxes[i]->y0 >= 0 &&
                boxes[i]->y1 <= 300);
    for (const PlotMarker& m : markers)
      EXPECT_FALSE(overlap(*boxes[i], {m.at.x - 7, m.at.y - 7, m.at.x + 7, m.at.y + 7}));
    for (std::size_t j = 0; j < i; ++j) EXPECT_FALSE(boxes[j] && overlap(*boxes[i], *boxes[j]));
  }
  EXPECT_GE(placed, 30);
}

TEST(PlaceLabels, KeepOffLinesAndGiveUpWithoutRoom) {
  const WantedLabel label{{100, 100}, 50, 15};
  std::vector<PlotPosition> line;
  for (double x = 0; x < 200; x += 3) line.push_back({x, 100});
  const auto boxes = place_labels({0, 0, 200, 200}, std::vector{label}, {}, line);
  ASSERT_TRUE(boxes[0]);
  EXPECT_TRUE(boxes[0]->y0 > 100 || boxes[0]->y1 < 100);
  EXPECT_FALSE(place_labels({90, 90, 110, 110}, std::vector{label}, {}, {})[0]);
}

TEST(NearestOn, IsOnTheBox) {
  const PlotPosition p = nearest_on({1, 2, 3, 4}, {9, 3});
  EXPECT_EQ(p.x, 3);
  EXPECT_EQ(p.y, 3);
}

}  // namespace
}  // namespace penumbra::tools
