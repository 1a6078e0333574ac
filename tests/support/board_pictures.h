// Boards drawn through any lens: OpenCV's own drawing on a plane, seen by a camera with 4 x 4
// samples a pixel, then its blur, its noise and what covers a part.
#pragma once

#include <cmath>
#include <glm/geometric.hpp>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <random>
#include <vector>

#include "calib/calib.h"
#include "core/conventions.h"

namespace penumbra::test {

/// A board's own drawing with where it lies on the board, in metres from the first corner, y down.
struct DrawnBoard {
  cv::Mat drawing;
  glm::dvec2 from_m, size_m;
  Pose world_from_board;
};

inline DrawnBoard draw_board(const calib::Board& board, const Pose& world_from_board) {
  constexpr int kSide = 120;  // samples of a square or a tag
  DrawnBoard out;
  out.world_from_board = world_from_board;
  const double paper = .4 * board.square_m;  // white around
  const int margin = kSide * 4 / 10;
  cv::Mat drawing;
  if (board.kind == calib::Board::Kind::kCharuco) {
    const auto charuco = cv::aruco::CharucoBoard::create(
        board.columns, board.rows, static_cast<float>(board.square_m),
        static_cast<float>(board.marker_m),
        cv::aruco::getPredefinedDictionary(cv::aruco::DICT_4X4_50));
    for (int& id : charuco->ids) id += board.first_id;
    charuco->draw({board.columns * kSide, board.rows * kSide}, drawing);
    out.from_m = glm::dvec2(-board.square_m - paper);
    out.size_m = board.square_m * glm::dvec2(board.columns, board.rows) + 2 * paper;
  } else {
    const double scale = kSide / board.square_m;
    const int gap = static_cast<int>(std::lround(board.marker_m * scale));
    drawing = cv::Mat(board.rows * kSide + (board.rows - 1) * gap,
                      board.columns * kSide + (board.columns - 1) * gap, CV_8U, cv::Scalar(255));
    const auto tags = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
    for (int i = 0; i < board.columns * board.rows; ++i) {
      cv::Mat tag;
      cv::aruco::drawMarker(tags, board.first_id + i, kSide, tag);
      tag.copyTo(drawing(cv::Rect(i % board.columns * (kSide + gap),
                                  i / board.columns * (kSide + gap), kSide, kSide)));
    }
    out.from_m = glm::dvec2(-paper);
    out.size_m = glm::dvec2(drawing.cols, drawing.rows) / scale + 2 * paper;
  }
  cv::copyMakeBorder(drawing, out.drawing, margin, margin, margin, margin, cv::BORDER_CONSTANT,
                     cv::Scalar(255));
  return out;
}

struct PictureFaults {
  double blur_px = .6, noise = 2;  // one sigma; codes
  cv::Rect covered{};              // grey
  unsigned seed = 1;
};

/// Keeps the lens's directions, which cost more than a picture.
class BoardPainter {
 public:
  explicit BoardPainter(const calib::CameraModel& lens) : lens_(lens) {
    for (int y = 0; y <= lens.height; ++y)
      for (int x = 0; x <= lens.width; ++x)
        corners_.push_back(calib::direction_from_pixel(lens, {x, y}).value_or(glm::dvec3(0)));
  }

  FramePixels paint(const std::vector<DrawnBoard>& boards, const Pose& world_from_camera,
                    const PictureFaults& faults = {}) const {
    cv::Mat grey(lens_.height, lens_.width, CV_32F);
    for (int y = 0; y < lens_.height; ++y)
      for (int x = 0; x < lens_.width; ++x)
        grey.at<float>(y, x) = static_cast<float>(110 + 30 * std::sin(.05 * x) * std::cos(.04 * y));
    for (const DrawnBoard& board : boards) add(board, world_from_camera, grey);
    if (!faults.covered.empty())
      grey(faults.covered & cv::Rect(0, 0, lens_.width, lens_.height)) = 90;
    if (faults.blur_px > 0) cv::GaussianBlur(grey, grey, {0, 0}, faults.blur_px);
    std::mt19937 rng(faults.seed);
    std::normal_distribution<float> noise(0, static_cast<float>(std::max(1e-3, faults.noise)));
    Image<Rgb8> out(lens_.width, lens_.height);
    for (int y = 0; y < lens_.height; ++y)
      for (int x = 0; x < lens_.width; ++x) {
        const auto v = cv::saturate_cast<std::uint8_t>(grey.at<float>(y, x) + noise(rng));
        out.at(x, y) = {v, v, v};
      }
    return out;
  }

 private:
  static constexpr int kSamples = 4;

  glm::dvec3 corner(int x, int y) const {
    return corners_[static_cast<std::size_t>(y * (lens_.width + 1) + x)];
  }

  // Where a ray meets the board, in parts of its drawing; nothing beside it.
  static std::optional<glm::dvec2> on_drawing(const DrawnBoard& board,
                                              const Pose& board_from_camera,
                                              const glm::dvec3& direction, double margin = 0) {
    const glm::dvec3 d = board_from_camera.rotation * direction,
                     from = board_from_camera.translation;
    if (!(d.z < 0) || from.z <= 0) return std::nullopt;
    const glm::dvec3 p = from - from.z / d.z * d;
    const glm::dvec2 at = (glm::dvec2(p.x, -p.y) - board.from_m) / board.size_m;
    if (at.x < -margin || at.y < -margin || at.x >= 1 + margin || at.y >= 1 + margin)
      return std::nullopt;
    return at;
  }

  void add(const DrawnBoard& board, const Pose& world_from_camera, cv::Mat& grey) const {
    constexpr double kPaper = 225, kInk = 25, kNear = .05;
    const Pose back = board.world_from_board.inverse() * world_from_camera;
    for (int y = 0; y < lens_.height; ++y)
      for (int x = 0; x < lens_.width; ++x) {
        const glm::dvec3 a = corner(x, y), b = corner(x + 1, y), c = corner(x, y + 1),
                         d = corner(x + 1, y + 1);
        if (glm::length(a) < .5 || glm::length(b) < .5 || glm::length(c) < .5 ||
            glm::length(d) < .5 || !on_drawing(board, back, a, kNear))
          continue;
        double sum = 0;
        for (int s = 0; s < kSamples * kSamples; ++s) {
          const double u = (s % kSamples + .5) / kSamples, v = (s / kSamples + .5) / kSamples;
          const auto at =
              on_drawing(board, back, (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d));
          if (!at) {
            sum += grey.at<float>(y, x);
            continue;
          }
          const auto code =
              board.drawing.at<std::uint8_t>(static_cast<int>(at->y * board.drawing.rows),
                                             static_cast<int>(at->x * board.drawing.cols));
          sum += kInk + (kPaper - kInk) * code / 255.;
        }
        grey.at<float>(y, x) = static_cast<float>(sum / (kSamples * kSamples));
      }
  }

  calib::CameraModel lens_;
  std::vector<glm::dvec3> corners_;
};

/// A camera at a place in the world that looks at another, its right side to the horizon.
inline Pose looking_at(const glm::dvec3& from, const glm::dvec3& to, double roll = 0) {
  const glm::dvec3 back = glm::normalize(from - to);
  const glm::dvec3 up = std::abs(back.y) < .999 ? glm::dvec3(0, 1, 0) : glm::dvec3(0, 0, -1);
  const glm::dvec3 right = glm::normalize(glm::cross(up, back));
  const glm::dquat q = glm::quat_cast(glm::dmat3(right, glm::cross(back, right), back));
  return {glm::normalize(q * glm::angleAxis(roll, glm::dvec3(0, 0, 1))), from};
}

}  // namespace penumbra::test
