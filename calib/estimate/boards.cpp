// Calls OpenCV; its exceptions end here.
#include "calib/estimate/boards.h"

#include <fmt/format.h>

#include <charconv>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace penumbra::calib {
namespace {

constexpr std::size_t kMinCorners = 6;

std::optional<double> to_number(std::string_view text) {
  double value = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || stop != text.data() + text.size()) return std::nullopt;
  return value;
}

std::vector<std::string_view> split(std::string_view text, char at) {
  std::vector<std::string_view> out;
  for (;;) {
    const auto end = text.find(at);
    out.push_back(text.substr(0, end));
    if (end == std::string_view::npos) return out;
    text.remove_prefix(end + 1);
  }
}

template <class Pixel>
cv::Mat luma(const Image<Pixel>& picture, double to_8_bits) {
  cv::Mat out(picture.height(), picture.width(), CV_8U);
  for (int y = 0; y < picture.height(); ++y) {
    const auto row = picture.row(y);
    auto* const to = out.ptr<std::uint8_t>(y);
    for (std::size_t x = 0; x < row.size(); ++x)
      to[x] = cv::saturate_cast<std::uint8_t>(
          to_8_bits * (.299 * row[x].r + .587 * row[x].g + .114 * row[x].b));
  }
  return out;
}

cv::Mat grey_of(const FramePixels& picture) {
  if (const auto* codes = std::get_if<Image<Rgb8>>(&picture)) return luma(*codes, 1);
  if (const auto* codes = std::get_if<Image<Rgb16>>(&picture)) return luma(*codes, 1 / 257.);
  return luma(std::get<Image<Rgb>>(picture), 255);
}

// OpenCV counts from the centre of the first pixel; only ChArUco corners from the border, as we do.
glm::dvec2 from_centre(const cv::Point2f& p) {
  return {p.x + .5, p.y + .5};
}
glm::dvec2 from_border(const cv::Point2f& p) {
  return {p.x, p.y};
}

void find_chessboard(const cv::Mat& grey, const Board& board, BoardView& view) {
  std::vector<cv::Point2f> corners;
  const cv::Size size(board.columns, board.rows);
  // The detector that stands strong distortion, first without its long search; the older one,
  // refined, sees some boards that it does not.
  const int usual = cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_ACCURACY;
  if (!cv::findChessboardCornersSB(grey, size, corners, usual) &&
      !cv::findChessboardCornersSB(grey, size, corners, usual | cv::CALIB_CB_EXHAUSTIVE)) {
    if (!cv::findChessboardCorners(
            grey, size, corners,
            cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_FAST_CHECK))
      return;
    cv::cornerSubPix(grey, corners, {5, 5}, {-1, -1},
                     {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 40, .001});
  }
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const auto columns = static_cast<std::size_t>(board.columns);
    view.pixels.push_back(from_centre(corners[i]));
    view.on_board_m.push_back(board.square_m * glm::dvec2(i % columns, i / columns));
  }
}

void find_charuco(const cv::Mat& grey, const Board& board, BoardView& view) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50);
  const auto charuco =
      cv::aruco::CharucoBoard::create(board.columns, board.rows, static_cast<float>(board.square_m),
                                      static_cast<float>(board.marker_m), dictionary);
  for (int& id : charuco->ids) id += board.first_id;
  std::vector<int> ids, corner_ids;
  std::vector<std::vector<cv::Point2f>> markers;
  cv::aruco::detectMarkers(grey, dictionary, markers, ids);
  if (ids.empty()) return;
  std::vector<cv::Point2f> corners;
  cv::aruco::interpolateCornersCharuco(markers, ids, grey, charuco, corners, corner_ids);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const int columns = board.columns - 1;
    view.pixels.push_back(from_border(corners[i]));
    view.on_board_m.push_back(board.square_m *
                              glm::dvec2(corner_ids[i] % columns, corner_ids[i] / columns));
  }
}

void find_apriltags(const cv::Mat& grey, const Board& board, BoardView& view) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
  auto parameters = cv::aruco::DetectorParameters::create();
  parameters->cornerRefinementMethod = cv::aruco::CORNER_REFINE_SUBPIX;
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> markers;
  cv::aruco::detectMarkers(grey, dictionary, markers, ids, parameters);
  constexpr glm::dvec2 kCorners[] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  for (std::size_t i = 0; i < ids.size(); ++i) {
    const int nth = ids[i] - board.first_id;
    if (nth < 0 || nth >= board.columns * board.rows) continue;
    const glm::dvec2 tag(nth % board.columns, nth / board.columns);
    for (std::size_t c = 0; c < 4; ++c) {
      view.pixels.push_back(from_centre(markers[i][c]));
      view.on_board_m.push_back(tag * (board.square_m + board.marker_m) +
                                board.square_m * kCorners[c]);
    }
  }
}

// Within the dictionary: 50 markers of 4x4_50, 587 of 36h11.
Result<void> set_first_id(std::string_view part, std::string_view text, Board& board) {
  const int known = board.kind == Board::Kind::kCharuco ? 50 : 587;
  const auto id = to_number(part);
  if (id && *id == std::floor(*id) && *id >= 0 && *id + marker_count(board) <= known) {
    board.first_id = static_cast<int>(*id);
    return {};
  }
  return fail(ErrorCode::kInvalid, "board \"" + std::string(text) + "\"",
              fmt::format("needs {} markers, of which its dictionary has {}: the first id is not a "
                          "whole number within 0..{}",
                          marker_count(board), known, known - marker_count(board)));
}

}  // namespace

int marker_count(const Board& board) {
  switch (board.kind) {
    case Board::Kind::kCharuco:
      return board.columns * board.rows / 2;
    case Board::Kind::kAprilTag:
      return board.columns * board.rows;
    default:
      return 0;
  }
}

Result<Board> parse_board(std::string_view text) {
  const auto invalid = [&](std::string detail) {
    return fail(ErrorCode::kInvalid, "board \"" + std::string(text) + "\"", std::move(detail));
  };
  constexpr std::string_view usage =
      "expected chessboard:COLUMNSxROWS:SQUARE_M (inner corners), "
      "charuco:COLUMNSxROWS:SQUARE_M:MARKER_M or apriltag:COLUMNSxROWS:TAG_M:GAP_M, with :FIRST_ID "
      "behind where it is not 0";
  const auto parts = split(text, ':');
  Board board;
  if (parts[0] == "charuco")
    board.kind = Board::Kind::kCharuco;
  else if (parts[0] == "apriltag")
    board.kind = Board::Kind::kAprilTag;
  else if (parts[0] != "chessboard")
    return invalid(std::string(usage));
  const bool marked = board.kind != Board::Kind::kChessboard;
  const bool numbered = marked && parts.size() == 5;
  if (!numbered && parts.size() != (marked ? 4u : 3u)) return invalid(std::string(usage));
  const auto sides = split(parts[1], 'x');
  const auto columns = to_number(sides[0]),
             rows = sides.size() == 2 ? to_number(sides[1]) : std::nullopt;
  const auto whole = [](const std::optional<double>& n) {
    return n && *n == std::floor(*n) && *n >= 2 && *n <= 100;
  };
  if (!whole(columns) || !whole(rows))
    return invalid("the columns and rows are not whole numbers within 2..100");
  const auto square = to_number(parts[2]), marker = marked ? to_number(parts[3]) : 0.;
  const auto metres = [](const std::optional<double>& n) { return n && *n > 0 && *n < 100; };
  if (!metres(square) || (marked && !metres(marker)))
    return invalid("a length is not above 0 and below 100 metres");
  board.columns = static_cast<int>(*columns);
  board.rows = static_cast<int>(*rows);
  board.square_m = *square;
  board.marker_m = *marker;
  if (board.kind == Board::Kind::kChessboard && (board.columns < 3 || board.rows < 3))
    return invalid("has fewer than 3x3 inner corners");
  if (board.kind == Board::Kind::kCharuco && board.columns * board.rows / 2 > 50)
    return invalid(
        "has more than 101 squares, for which 50 markers of the dictionary 4x4_50 do not suffice");
  if (board.kind == Board::Kind::kCharuco && board.marker_m >= board.square_m)
    return invalid("has markers that are not smaller than their squares");
  if (marked) PENUMBRA_TRY(set_first_id(numbered ? parts[4] : "0", text, board));
  return board;
}

std::optional<BoardView> find_board(const FramePixels& picture, const Board& board,
                                    std::string name) {
  BoardView view{.name = std::move(name), .pixels = {}, .on_board_m = {}};
  try {
    const cv::Mat grey = grey_of(picture);
    switch (board.kind) {
      case Board::Kind::kChessboard:
        find_chessboard(grey, board, view);
        break;
      case Board::Kind::kCharuco:
        find_charuco(grey, board, view);
        break;
      case Board::Kind::kAprilTag:
        find_apriltags(grey, board, view);
        break;
    }
  } catch (const cv::Exception&) {
    return std::nullopt;  // OpenCV's way of saying that it can't make sense of a picture
  }
  if (view.pixels.size() < kMinCorners) return std::nullopt;
  return view;
}

}  // namespace penumbra::calib
