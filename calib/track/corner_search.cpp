// Calls OpenCV; its exceptions end here.
#include "calib/track/internal/corner_search.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <opencv2/aruco.hpp>
#include <opencv2/imgproc.hpp>

#include "core/median.h"

namespace penumbra::calib {

namespace {

constexpr int kSmallestWindow = 2, kLargestWindow = 7;  // pixels to each side of a corner

std::uint8_t grey_of_pixel(const Rgb8& p) {
  return static_cast<std::uint8_t>((77 * p.r + 150 * p.g + 29 * p.b) >> 8);
}
std::uint8_t grey_of_pixel(const Rgb16& p) {
  return static_cast<std::uint8_t>((77u * p.r + 150u * p.g + 29u * p.b) >> 16);
}
std::uint8_t grey_of_pixel(const Rgb& p) {
  const float y = .299f * p.r + .587f * p.g + .114f * p.b;
  return static_cast<std::uint8_t>(y > 0 ? 255 * std::min(y, 1.f) : 0.f);  // NaN is black
}

// Projects what lies on a board.
class BoardView2D {
 public:
  BoardView2D(const CameraModel& lens, const LaidBoard& board, const Pose& world_from_camera)
      : lens_(lens), camera_from_board_(world_from_camera.inverse() * board.world_from_board) {}
  std::optional<glm::dvec2> pixel(glm::dvec2 at) const {
    const glm::dvec3 p = camera_from_board_ * glm::dvec3(at.x, -at.y, 0);
    const double length = glm::length(p);
    if (!(length > 1e-9)) return std::nullopt;
    return pixel_from_direction(lens_, p / length);
  }
  bool faces() const {
    return glm::dot(camera_from_board_.rotation * glm::dvec3(0, 0, 1),
                    camera_from_board_.translation) < 0;
  }

 private:
  const CameraModel& lens_;
  Pose camera_from_board_;
};

struct Expected {
  FoundCorner corner;
  double clear_px;
  int window;
};

std::vector<Expected> expected_corners(const GreyPart& grey, const CameraModel& lens,
                                       std::span<const LaidBoard> boards,
                                       const Pose& world_from_camera) {
  std::vector<Expected> out;
  for (std::size_t b = 0; b < boards.size(); ++b) {
    const BoardView2D view(lens, boards[b], world_from_camera);
    if (!boards[b].counts || !view.faces()) continue;
    const BoardLayout& layout = boards[b].layout;
    for (std::size_t i = 0; i < layout.points.size(); ++i) {
      const glm::dvec2 at = layout.points[i].at_m;
      const auto middle = view.pixel(at), right = view.pixel(at + glm::dvec2(layout.clear_m, 0)),
                 below = view.pixel(at + glm::dvec2(0, layout.clear_m));
      if (!middle || !right || !below) continue;
      const double clear = std::min(glm::length(*right - *middle), glm::length(*below - *middle));
      if (!(clear >= 1)) continue;
      const int window = std::clamp(static_cast<int>(clear), kSmallestWindow, kLargestWindow);
      const double border = window + 2;
      const GreyPart::GreyBounds& in = grey.bounds();
      if (middle->x < in.left + border || middle->y < in.top + border ||
          middle->x > in.right - border || middle->y > in.bottom - border)
        continue;
      out.push_back({{b, i, *middle}, clear, window});
    }
  }
  return out;
}

// Of a point with one black quarter; of a saddle point 0.
glm::dvec2 inward_of(const BoardView2D& view, const BoardLayout& layout,
                     const BoardLayout::Corner& point) {
  if (std::ranges::count(point.black, true) != 1) return glm::dvec2(0);
  const auto q =
      static_cast<std::size_t>(std::ranges::find(point.black, true) - point.black.begin());
  // The bisector of the corner as it is seen, which is not that on the board.
  const glm::dvec2 side(q % 2 ? 1 : -1, q / 2 ? 1 : -1);
  const auto at = view.pixel(point.at_m),
             along = view.pixel(point.at_m + glm::dvec2(layout.clear_m * side.x, 0)),
             across = view.pixel(point.at_m + glm::dvec2(0, layout.clear_m * side.y));
  if (!at || !along || !across) return glm::dvec2(0);
  const glm::dvec2 a = glm::normalize(*along - *at), b = glm::normalize(*across - *at);
  const double sine = std::abs(a.x * b.y - a.y * b.x);
  return sine > .1 ? (a + b) / sine : glm::dvec2(0);
}

// Black where the layout says so, and white around it.
bool looks_right(const GreyPart& grey, const BoardView2D& view, const BoardLayout& layout,
                 const BoardLayout::Corner& point, glm::dvec2 shift) {
  constexpr double kContrast = 8;  // codes
  double darkest_white = 255, brightest_black = 0;
  for (std::size_t q = 0; q < 4; ++q) {
    const glm::dvec2 side(q % 2 ? 1 : -1, q / 2 ? 1 : -1);
    const auto at = view.pixel(point.at_m + .6 * layout.clear_m * side);
    const auto code = at ? grey.at(*at + shift) : std::nullopt;
    if (!code) return false;
    if (point.black[q])
      brightest_black = std::max(brightest_black, *code);
    else
      darkest_white = std::min(darkest_white, *code);
  }
  return darkest_white - brightest_black > kContrast;
}

// Of cells inside a marker's border: the fraction that is as the layout says; nothing where the
// picture does not show them.
std::optional<double> read_marker(const GreyPart& grey, const BoardView2D& view,
                                  const BoardLayout& layout, const BoardLayout::Marking& marker) {
  constexpr double kSmallestCell_px = 1.1, kContrast = 12;
  const double cell = layout.marker_m / layout.cells;
  const auto first = view.pixel(marker.at_m), last = view.pixel(marker.at_m + layout.marker_m);
  if (!first || !last ||
      glm::length(*last - *first) < kSmallestCell_px * std::sqrt(2.) * layout.cells)
    return std::nullopt;
  std::vector<double> codes;
  double low = 255, high = 0;
  for (int i = 0; i < layout.cells * layout.cells; ++i) {
    const auto at =
        view.pixel(marker.at_m + cell * (glm::dvec2(i % layout.cells, i / layout.cells) + .5));
    const auto code = at ? grey.at(*at) : std::nullopt;
    if (!code) return std::nullopt;
    codes.push_back(*code);
    low = std::min(low, *code), high = std::max(high, *code);
  }
  if (high - low < kContrast) return 0.;
  int right = 0, all = 0;
  for (int y = 1; y + 1 < layout.cells; ++y)
    for (int x = 1; x + 1 < layout.cells; ++x) {
      const auto i = static_cast<std::size_t>(layout.cells * y + x);
      right += (codes[i] < (low + high) / 2) == marker.black[i];
      ++all;
    }
  return static_cast<double>(right) / all;
}

std::vector<FoundMarking> detect(const cv::Mat& grey, std::span<const LaidBoard> boards,
                                 Board::Kind kind) {
  const auto dictionary = cv::aruco::getPredefinedDictionary(
      kind == Board::Kind::kCharuco ? cv::aruco::DICT_4X4_50 : cv::aruco::DICT_APRILTAG_36h11);
  auto parameters = cv::aruco::DetectorParameters::create();
  parameters->minMarkerPerimeterRate = .02;
  std::vector<int> ids;
  std::vector<std::vector<cv::Point2f>> corners;
  cv::aruco::detectMarkers(grey, dictionary, corners, ids, parameters);
  std::map<int, int> times;
  for (const int id : ids) ++times[id];
  std::vector<FoundMarking> out;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (times[ids[i]] != 1) continue;
    for (std::size_t b = 0; b < boards.size(); ++b) {
      const int nth = ids[i] - boards[b].board.first_id;
      if (boards[b].board.kind != kind || nth < 0 ||
          nth >= static_cast<int>(boards[b].layout.markers.size()))
        continue;
      FoundMarking marking{b, static_cast<std::size_t>(nth), {}};
      for (std::size_t c = 0; c < 4; ++c)
        marking.corners_px[c] = glm::dvec2(corners[i][c].x + .5, corners[i][c].y + .5);
      out.push_back(marking);
    }
  }
  return out;
}

}  // namespace

void GreyPart::set(const FramePixels& picture, GreyBounds bounds) {
  std::visit(
      [&](const auto& image) {
        bounds_ = {std::max(0, bounds.left), std::max(0, bounds.top),
                   std::min(image.width(), bounds.right), std::min(image.height(), bounds.bottom)};
        if (bounds_.empty()) bounds_ = {};
        codes_.resize(static_cast<std::size_t>(width()) * static_cast<std::size_t>(height()));
        auto* to = codes_.data();
        for (int y = bounds_.top; y < bounds_.bottom; ++y) {
          const auto row = image.row(y).subspan(static_cast<std::size_t>(bounds_.left),
                                                static_cast<std::size_t>(width()));
          for (const auto& pixel : row) *to++ = grey_of_pixel(pixel);
        }
      },
      picture);
}

std::optional<double> GreyPart::at(glm::dvec2 pixel) const {
  const double x = pixel.x - .5 - bounds_.left, y = pixel.y - .5 - bounds_.top;
  if (!(x >= 0 && y >= 0 && x < width() - 1 && y < height() - 1)) return std::nullopt;
  const auto column = static_cast<std::size_t>(x), row = static_cast<std::size_t>(y);
  const double u = x - static_cast<double>(column), v = y - static_cast<double>(row);
  const auto w = static_cast<std::size_t>(width());
  const std::uint8_t* const p = codes_.data() + row * w + column;
  return (1 - v) * ((1 - u) * p[0] + u * p[1]) + v * ((1 - u) * p[w] + u * p[w + 1]);
}

std::vector<FoundMarking> find_markers(GreyPart& grey, std::span<const LaidBoard> boards,
                                       bool enlarged) {
  std::vector<FoundMarking> out;
  if (grey.bounds().empty()) return out;
  cv::Mat whole(grey.height(), grey.width(), CV_8U, grey.data());
  if (enlarged) cv::resize(whole, whole, {}, 2, 2, cv::INTER_LINEAR);
  const glm::dvec2 origin(grey.bounds().left, grey.bounds().top);
  for (const Board::Kind kind : {Board::Kind::kCharuco, Board::Kind::kAprilTag}) {
    if (std::ranges::none_of(boards, [&](const LaidBoard& b) { return b.board.kind == kind; }))
      continue;
    try {
      for (FoundMarking& marking : detect(whole, boards, kind)) {
        for (glm::dvec2& p : marking.corners_px) p = origin + (enlarged ? .5 : 1.) * p;
        out.push_back(marking);
      }
    } catch (const cv::Exception&) {
      continue;  // OpenCV's way of saying that it can't make sense of a picture
    }
  }
  return out;
}

CornerSearch find_corners(GreyPart& grey, const CameraModel& lens,
                          std::span<const LaidBoard> boards, const Pose& world_from_camera) {
  CornerSearch out;
  const auto expected = expected_corners(grey, lens, boards, world_from_camera);
  out.expected = static_cast<int>(expected.size());
  if (expected.empty()) return out;
  std::vector<BoardView2D> views;
  for (const LaidBoard& board : boards) views.emplace_back(lens, board, world_from_camera);
  const cv::Mat part(grey.height(), grey.width(), CV_8U, grey.data());
  const glm::dvec2 centres = glm::dvec2(grey.bounds().left, grey.bounds().top) + .5;
  std::vector<cv::Point2f> corners;
  std::vector<const Expected*> those;
  std::vector<double> moved;
  for (int window = kSmallestWindow; window <= kLargestWindow; ++window) {
    corners.clear(), those.clear();
    for (const Expected& e : expected) {
      if (e.window != window) continue;
      const glm::dvec2 p = e.corner.pixel - centres;
      corners.emplace_back(static_cast<float>(p.x), static_cast<float>(p.y));
      those.push_back(&e);
    }
    if (corners.empty()) continue;
    try {
      cv::cornerSubPix(part, corners, {window, window}, {-1, -1},
                       {cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 12, .01});
    } catch (const cv::Exception&) {
      continue;
    }
    for (std::size_t i = 0; i < corners.size(); ++i) {
      FoundCorner found = those[i]->corner;
      const glm::dvec2 at = glm::dvec2(corners[i].x, corners[i].y) + centres,
                       shift = at - found.pixel;
      // cornerSubPix leaves a corner that wanders off where it was.
      if (!(glm::length(shift) <= window + 1) || shift == glm::dvec2(0)) continue;
      const LaidBoard& board = boards[found.board];
      if (!looks_right(grey, views[found.board], board.layout, board.layout.points[found.point],
                       shift))
        continue;
      moved.push_back(glm::length(shift));
      found.pixel = at;
      found.inward = inward_of(views[found.board], board.layout, board.layout.points[found.point]);
      out.found.push_back(found);
    }
  }
  if (!moved.empty()) out.moved_px = median(moved);
  return out;
}

void take_back_rounding(const CameraModel& lens, std::span<const LaidBoard> boards,
                        const Pose& world_from_camera, std::vector<FoundCorner>& corners) {
  std::vector<BoardView2D> views;
  for (const LaidBoard& board : boards) views.emplace_back(lens, board, world_from_camera);
  std::vector<double> inside;
  for (const FoundCorner& c : corners)
    if (c.inward != glm::dvec2(0))
      if (const auto at = views[c.board].pixel(boards[c.board].layout.points[c.point].at_m))
        inside.push_back(glm::dot(c.pixel - *at, c.inward) / glm::dot(c.inward, c.inward));
  if (inside.empty()) return;
  const double middle = median(inside);
  for (FoundCorner& c : corners) c.pixel -= middle * c.inward;
}

GreyPart::GreyBounds bounds_of(const CameraModel& lens, std::span<const LaidBoard> boards,
                               const Pose& world_from_camera) {
  constexpr double kMargin = .04;  // of the picture's longer side
  const double margin = kMargin * std::max(lens.width, lens.height);
  glm::dvec2 low(1e9), high(-1e9);
  for (const LaidBoard& board : boards) {
    const BoardView2D view(lens, board, world_from_camera);
    if (!board.counts || !view.faces()) continue;
    for (const BoardLayout::Corner& point : board.layout.points)
      if (const auto at = view.pixel(point.at_m)) {
        low = glm::min(low, *at - margin);
        high = glm::max(high, *at + margin);
      }
  }
  if (!(low.x < high.x)) return {};
  const auto whole = [](double v) { return static_cast<int>(std::clamp(v, -1e6, 1e6)); };
  GreyPart::GreyBounds out{whole(low.x), whole(low.y), whole(high.x), whole(high.y)};
  out.left = std::max(out.left, 0), out.top = std::max(out.top, 0);
  out.right = std::min(out.right, lens.width), out.bottom = std::min(out.bottom, lens.height);
  return out;
}

bool markers_agree(const GreyPart& grey, const CameraModel& lens, std::span<const LaidBoard> boards,
                   const Pose& world_from_camera) {
  constexpr double kRight = .8, kOfThoseSeen = .25;
  int seen = 0, right = 0;
  for (const LaidBoard& board : boards) {
    const BoardView2D view(lens, board, world_from_camera);
    if (!board.counts || !view.faces()) continue;
    for (const BoardLayout::Marking& marker : board.layout.markers)
      if (const auto fraction = read_marker(grey, view, board.layout, marker)) {
        ++seen;
        right += *fraction >= kRight;
      }
  }
  return right >= std::min(seen, 2) && right >= kOfThoseSeen * seen && right > 0;
}

}  // namespace penumbra::calib
