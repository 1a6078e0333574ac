// Calls OpenCV for its dictionaries' patterns; its exceptions end here.
#include <algorithm>
#include <opencv2/aruco.hpp>

#include "calib/track/internal/board_layout.h"

namespace penumbra::calib {

namespace {

std::vector<bool> cells_of(const cv::Ptr<cv::aruco::Dictionary>& dictionary, int id, int cells) {
  std::vector<bool> out(static_cast<std::size_t>(cells) * static_cast<std::size_t>(cells), true);
  try {
    cv::Mat drawn;
    cv::aruco::drawMarker(dictionary, id, cells, drawn, 1);
    for (int i = 0; i < cells * cells; ++i)
      out[static_cast<std::size_t>(i)] = drawn.at<std::uint8_t>(i / cells, i % cells) < 128;
  } catch (const cv::Exception&) {
    // An id beyond the dictionary, which parse_board() refuses: a black marker is never found.
    std::fill(out.begin(), out.end(), true);
  }
  return out;
}

void lay_squares(const Board& board, bool with_markers, BoardLayout& out) {
  const double s = board.square_m, margin = (s - board.marker_m) / 2;
  const int columns = with_markers ? board.columns : board.columns + 1,
            rows = with_markers ? board.rows : board.rows + 1;
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50);
  out.cells = with_markers ? dictionary->markerSize + 2 : 0;
  out.marker_m = with_markers ? board.marker_m : 0;
  out.clear_m = with_markers ? margin : s / 2;
  int id = board.first_id;
  for (int y = 0; y < rows; ++y)
    for (int x = 0; x < columns; ++x) {
      const glm::dvec2 at = s * glm::dvec2(x - 1, y - 1);
      const bool black = (x + y) % 2 == 0;
      if (black)
        out.squares.push_back({at, {s, s}});
      else if (with_markers) {
        out.markers.push_back({id, at + margin, cells_of(dictionary, id, out.cells)});
        ++id;
      }
      if (x > 0 && y > 0) out.points.push_back({at, {black, !black, !black, black}});
    }
  out.outline = {{-s, -s}, s * glm::dvec2(columns, rows)};
}

void lay_tags(const Board& board, BoardLayout& out) {
  const double tag = board.square_m, step = tag + board.marker_m;
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
  out.cells = dictionary->markerSize + 2;
  out.marker_m = tag;
  out.clear_m = std::min(board.marker_m, tag / out.cells);
  for (int i = 0; i < board.columns * board.rows; ++i) {
    const glm::dvec2 at = step * glm::dvec2(i % board.columns, i / board.columns);
    out.markers.push_back(
        {board.first_id + i, at, cells_of(dictionary, board.first_id + i, out.cells)});
    for (std::size_t c = 0; c < 4; ++c) {
      BoardLayout::Corner corner{at + tag * glm::dvec2(c % 2, c / 2), {}};
      corner.black[3 - c] = true;  // the tag itself
      out.points.push_back(corner);
    }
  }
  out.outline = {{0, 0}, step * glm::dvec2(board.columns, board.rows) - board.marker_m};
}

}  // namespace

BoardLayout layout_of(const Board& board) {
  BoardLayout out;
  if (board.kind == Board::Kind::kAprilTag)
    lay_tags(board, out);
  else
    lay_squares(board, board.kind == Board::Kind::kCharuco, out);
  return out;
}

std::vector<BoardLayout::Rectangle> black_of(const BoardLayout& layout) {
  std::vector<BoardLayout::Rectangle> out = layout.squares;
  const auto n = static_cast<std::size_t>(layout.cells);
  const double cell = layout.cells > 0 ? layout.marker_m / layout.cells : 0;
  for (const BoardLayout::Marking& marker : layout.markers)
    for (std::size_t y = 0; y < n; ++y)
      for (std::size_t x = 0, end = 0; x < n; x = std::max(end, x + 1)) {
        for (end = x; end < n && marker.black[n * y + end];) ++end;
        if (end > x)
          out.push_back({marker.at_m + cell * glm::dvec2(x, y),
                         cell * glm::dvec2(static_cast<double>(end - x), 1)});
      }
  return out;
}

std::vector<glm::dvec2> white_places(const Board& board) {
  const BoardLayout layout = layout_of(board);
  // Half way to what is next: another tag, or the end of a ChArUco board's white square.
  const bool tags = board.kind == Board::Kind::kAprilTag;
  const double gap_m = tags ? board.marker_m : (board.square_m - board.marker_m) / 2;
  std::vector<glm::dvec2> out;
  for (const BoardLayout::Marking& m : layout.markers) {
    out.push_back(m.at_m + glm::dvec2(layout.marker_m / 2, -gap_m / 2));
    out.push_back(m.at_m + glm::dvec2(-gap_m / 2, layout.marker_m / 2));
  }
  return out;
}

}  // namespace penumbra::calib
