// Calls OpenCV for the first guess; its exceptions end here.
#include "calib/track/internal/pose_solver.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>
#define GLM_ENABLE_EXPERIMENTAL
#include <glm/gtx/quaternion.hpp>
#include <opencv2/calib3d.hpp>

#include "calib/track/internal/small_turns.h"

namespace penumbra::calib {

namespace {

constexpr double kSmallestSigma_px = .05, kTukey = 4.685;
constexpr std::size_t kFewest = 4;

glm::dvec2 off_by(const Sighting& s, const glm::dvec3& in_camera) {
  const glm::dvec3 d = glm::normalize(in_camera) - s.seen;
  return {glm::dot(s.pixels[0], d), glm::dot(s.pixels[1], d)};
}

double tukey_weight(double r, double sigma) {
  const double u = r / (kTukey * sigma);
  return u < 1 ? (1 - u * u) * (1 - u * u) : 0;
}
double tukey_loss(double r, double sigma) {
  const double c = kTukey * sigma, u = std::min(1., r / c), left = 1 - u * u;
  return c * c / 6 * (1 - left * left * left);
}

// Of one coordinate, from the median of distances in two (Rayleigh).
double robust_sigma(std::vector<double> off) {
  constexpr double kMedianOfRayleigh = 1.1774;
  std::ranges::nth_element(off, off.begin() + std::ssize(off) / 2);
  return std::max(kSmallestSigma_px, off[off.size() / 2] / kMedianOfRayleigh);
}

class PoseFit {
 public:
  PoseFit(std::span<const Sighting> points, const Pose& start) : points_(points), pose_(start) {}

  bool run() {
    constexpr int kRounds = 3, kSteps = 20;
    for (int round = 0; round < kRounds; ++round) {
      measure(pose_, off_);
      const double before = sigma_;
      sigma_ = robust_sigma(off_);
      if (round > 0 && sigma_ > .9 * before) break;
      double damping = 1e-3;
      for (int step = 0; step < kSteps && descend(damping);) ++step;
    }
    measure(pose_, off_);
    return std::isfinite(cost(off_));
  }

  std::optional<SolvedPose> result() {
    SolvedPose out{pose_, {}, 0, sigma_, 0, off_};
    double squares = 0;
    for (const double off : off_)
      if (off < 3 * std::sqrt(2.) * sigma_) squares += off * off, ++out.used;
    if (out.used < static_cast<int>(kFewest)) return std::nullopt;
    out.rms_px = std::sqrt(squares / (2. * out.used));
    const double variance =
        std::max(squares / std::max(1, 2 * out.used - 6), kSmallestSigma_px * kSmallestSigma_px);
    linearise();
    const auto inverse = inverse_of(normal_);
    if (!inverse) return std::nullopt;
    out.covariance = variance * *inverse;
    return out;
  }

 private:
  void measure(const Pose& pose, std::vector<double>& off) const {
    const Pose back = pose.inverse();
    off.clear();
    for (const Sighting& s : points_) off.push_back(glm::length(off_by(s, back * s.in_world)));
  }
  double cost(const std::vector<double>& off) const {
    double sum = 0;
    for (const double r : off) sum += tukey_loss(r, sigma_);
    return sum;
  }

  // Turned by w about the world's axes and moved by d, the camera sees R^T (1 - [w]x)(X - c - d).
  void linearise() {
    normal_ = {};
    gradient_ = {};
    const glm::dmat3 camera_from_world = glm::transpose(pose_.rotation_matrix());
    for (std::size_t i = 0; i < points_.size(); ++i) {
      const double weight = tukey_weight(off_[i], sigma_);
      if (!(weight > 0)) continue;
      const glm::dvec3 from = points_[i].in_world - pose_.translation, p = camera_from_world * from;
      const double length = glm::length(p);
      const glm::dvec3 d = p / length;
      const glm::dvec2 r = off_by(points_[i], p);
      for (int k = 0; k < 2; ++k) {
        const glm::dvec3 row = points_[i].pixels[static_cast<std::size_t>(k)];
        // By p, then by the world.
        const glm::dvec3 by_p = (row - glm::dot(row, d) * d) / length,
                         by_x = glm::transpose(camera_from_world) * by_p,
                         by_turn = glm::cross(by_x, from);
        const Vector6 j{by_turn.x, by_turn.y, by_turn.z, -by_x.x, -by_x.y, -by_x.z};
        for (std::size_t a = 0; a < 6; ++a) {
          gradient_[a] -= weight * j[a] * r[k];
          for (std::size_t b = 0; b < 6; ++b) normal_(a, b) += weight * j[a] * j[b];
        }
      }
    }
  }

  // False at the end.
  bool descend(double& damping) {
    linearise();
    const double now = cost(off_);
    for (int tries = 0; tries < 8; ++tries, damping *= 10) {
      Matrix6 damped = normal_;
      for (std::size_t i = 0; i < 6; ++i) damped(i, i) *= 1 + damping;
      const auto l = cholesky(damped);
      if (!l) continue;
      const Vector6 step = solve_by(*l, gradient_);
      const Pose moved{glm::normalize(rotation_by({step[0], step[1], step[2]}) * pose_.rotation),
                       pose_.translation + glm::dvec3(step[3], step[4], step[5])};
      measure(moved, tried_);
      const double then = cost(tried_);
      if (!(then <= now)) continue;
      pose_ = moved;
      off_.swap(tried_);
      damping = std::max(1e-9, damping / 10);
      return now - then > 1e-7 * now;
    }
    return false;
  }

  std::span<const Sighting> points_;
  Pose pose_;
  double sigma_ = kSmallestSigma_px;
  std::vector<double> off_, tried_;
  Matrix6 normal_;
  Vector6 gradient_{};
};

}  // namespace

std::optional<Sighting> sighting_of(const CameraModel& lens, glm::dvec2 pixel,
                                    const glm::dvec3& in_world) {
  const auto seen = direction_from_pixel(lens, pixel);
  if (!seen) return std::nullopt;
  Sighting out{in_world, *seen, {}};
  const glm::dvec3 any = std::abs(seen->z) < .9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0);
  const glm::dvec3 u = glm::normalize(glm::cross(*seen, any)), v = glm::cross(*seen, u);
  constexpr double kStep = 1e-5;  // radian
  for (const glm::dvec3& side : {u, v}) {
    const auto ahead = pixel_from_direction(lens, glm::normalize(*seen + kStep * side)),
               behind = pixel_from_direction(lens, glm::normalize(*seen - kStep * side));
    if (!ahead || !behind) return std::nullopt;
    const glm::dvec2 slope = (*ahead - *behind) / (2 * kStep);
    out.pixels[0] += slope.x * side;
    out.pixels[1] += slope.y * side;
  }
  return out;
}

std::optional<SolvedPose> solve_pose(std::span<const Sighting> points, const Pose& start) {
  if (points.size() < kFewest) return std::nullopt;
  PoseFit fit(points, start);
  if (!fit.run()) return std::nullopt;
  return fit.result();
}

double misfit(const SolvedPose& pose, double sigma_px) {
  constexpr double kMost = 5;
  double sum = 0;
  for (const double off : pose.off_px) {
    const double r = std::min(kMost, off / sigma_px);
    sum += r * r;
  }
  return sum;
}

Pose leaned_the_other_way(const Pose& world_from_camera, const glm::dvec3& middle,
                          const glm::dmat3& world_from_board) {
  const Pose camera_from_world = world_from_camera.inverse();
  const glm::dvec3 at = camera_from_world * middle, sight = glm::normalize(at);
  const glm::dmat3 seen = camera_from_world.rotation_matrix() * world_from_board;
  const auto mirrored = [&](const glm::dvec3& a) { return a - 2 * glm::dot(sight, a) * sight; };
  const glm::dmat3 leaned(mirrored(seen[0]), mirrored(seen[1]), -mirrored(seen[2]));
  const glm::dquat rotation =
      glm::normalize(glm::quat_cast(leaned * glm::transpose(world_from_board)));
  return Pose{rotation, at - rotation * middle}.inverse();
}

std::optional<Pose> flat_board_pose(std::span<const glm::dvec3> seen,
                                    std::span<const glm::dvec2> on_board) {
  constexpr double kWidest = .17;  // cosine of the angle from the middle
  glm::dvec3 sum(0);
  for (const glm::dvec3& d : seen) sum += d;
  if (seen.size() < kFewest || glm::length(sum) < 1e-6) return std::nullopt;
  const glm::dquat aimed_from_camera = glm::rotation(glm::normalize(sum), glm::dvec3(0, 0, -1));
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> plane;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    const glm::dvec3 d = aimed_from_camera * seen[i];
    if (-d.z < kWidest) return std::nullopt;
    board.emplace_back(on_board[i].x, on_board[i].y, 0);
    plane.emplace_back(d.x / -d.z, d.y / d.z);  // y down
  }
  cv::Mat vector, place, matrix;
  try {
    if (!cv::solvePnP(board, plane, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), vector, place, false,
                      cv::SOLVEPNP_IPPE))
      return std::nullopt;
    cv::Rodrigues(vector, matrix);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  if (!(place.at<double>(2) > 0)) return std::nullopt;
  const glm::dvec3 flip(1, -1, -1);  // from the picture's axes to ours, on both sides
  glm::dmat3 r;
  for (int column = 0; column < 3; ++column)
    for (int row = 0; row < 3; ++row)
      r[column][row] = flip[row] * matrix.at<double>(row, column) * flip[column];
  const glm::dvec3 t =
      flip * glm::dvec3(place.at<double>(0), place.at<double>(1), place.at<double>(2));
  return Pose{glm::conjugate(aimed_from_camera), {0, 0, 0}} *
         Pose{glm::normalize(glm::quat_cast(r)), t};
}

}  // namespace penumbra::calib
