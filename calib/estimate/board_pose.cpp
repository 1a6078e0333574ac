// Calls OpenCV; its exceptions end here.
#include <cmath>
#include <glm/geometric.hpp>
#define GLM_ENABLE_EXPERIMENTAL
#include <glm/gtx/quaternion.hpp>
#include <opencv2/calib3d.hpp>

#include "calib/camera/camera_model.h"
#include "calib/estimate/boards.h"
#include "calib/estimate/rig_calibration.h"

namespace penumbra::calib {

namespace {

glm::dmat3 from_opencv(const cv::Mat& rotation_vector) {
  cv::Mat r;
  cv::Rodrigues(rotation_vector, r);
  glm::dmat3 out;
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) out[column][row] = r.at<double>(row, column);
  return out;
}

}  // namespace

// As a pinhole would see it that looks at the board's middle: no corner is then far from its axis.
std::optional<Pose> board_pose(const CameraModel& projection, const BoardView& view) {
  constexpr double kWidest = .17;  // cosine of the angle from the middle
  std::vector<glm::dvec3> seen;
  glm::dvec3 sum(0);
  for (const glm::dvec2& pixel : view.pixels) {
    const auto d = direction_from_pixel(projection, pixel);
    if (!d) return std::nullopt;
    seen.push_back(*d);
    sum += *d;
  }
  if (seen.size() < 6 || glm::length(sum) < 1e-6) return std::nullopt;
  const glm::dquat aimed_from_camera = glm::rotation(glm::normalize(sum), glm::dvec3(0, 0, -1));
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> plane;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const glm::dvec3 d = aimed_from_camera * seen[i];
    if (-d.z < kWidest) return std::nullopt;
    board.emplace_back(view.on_board_m[i].x, view.on_board_m[i].y, 0);
    plane.emplace_back(d.x / -d.z, d.y / d.z);  // y down
  }
  cv::Mat rotation, translation;
  try {
    if (!cv::solvePnP(board, plane, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), rotation,
                      translation, false, cv::SOLVEPNP_IPPE))
      return std::nullopt;
    cv::solvePnPRefineLM(board, plane, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), rotation,
                         translation);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  const glm::dvec3 flip(1, -1, -1);  // from the picture's axes to ours, on both sides
  glm::dmat3 r = from_opencv(rotation);
  for (int c = 0; c < 3; ++c) r[c] = flip * r[c] * flip[c];
  const glm::dvec3 t(translation.at<double>(0), translation.at<double>(1),
                     translation.at<double>(2));
  if (!(t.z > 0)) return std::nullopt;
  const Pose aimed{glm::normalize(glm::quat_cast(r)), flip * t};
  return Pose{glm::conjugate(aimed_from_camera), {0, 0, 0}} * aimed;
}

}  // namespace penumbra::calib
