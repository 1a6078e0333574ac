#include "calib/estimate/internal/rig_start.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <limits>
#include <opencv2/calib3d.hpp>

#include "core/conventions.h"

namespace penumbra::calib {

std::unexpected<Error> rig_undetermined(std::string detail) {
  return fail(ErrorCode::kUndetermined, "rig calibration", std::move(detail));
}

namespace {

// Angle-axis of a rotation, radian.
glm::dvec3 turn_of(glm::dquat q) {
  if (q.w < 0) q = -q;
  const glm::dvec3 v(q.x, q.y, q.z);
  const double s = glm::length(v);
  return s > 1e-12 ? v * (2 * std::atan2(s, q.w) / s) : 2. * v;
}

double angle_between(const glm::dquat& a, const glm::dquat& b) {
  return glm::length(turn_of(a * glm::conjugate(b)));
}

// The pose that lies nearest to all of them; half a metre counts as a radian.
Pose medoid(const std::vector<Pose>& poses) {
  const Pose* best = nullptr;
  double smallest = std::numeric_limits<double>::infinity();
  for (const Pose& p : poses) {
    double sum = 0;
    for (const Pose& q : poses)
      sum += 2 * glm::length(p.translation - q.translation) + angle_between(p.rotation, q.rotation);
    if (sum < smallest) smallest = sum, best = &p;
  }
  return *best;
}

struct Posed {
  const RigObservation* view;
  Pose camera_from_board;
};

// Views of one moment have one number.
std::vector<std::size_t> number_moments(const std::vector<Posed>& views, double max_time_apart_s,
                                        std::vector<double>& times_s) {
  std::vector<std::size_t> out;
  std::vector<std::size_t> seen_by;  // cameras of the moment under way
  for (const Posed& v : views) {
    const bool same = !times_s.empty() && v.view->time_s - times_s.back() <= max_time_apart_s &&
                      std::ranges::find(seen_by, v.view->camera) == seen_by.end();
    if (!same) times_s.push_back(v.view->time_s), seen_by.clear();
    seen_by.push_back(v.view->camera);
    out.push_back(times_s.size() - 1);
  }
  return out;
}

// Camera by camera along the pairs that see the board at once.
Result<std::vector<Pose>> chain_cameras(std::span<const RigCameraInput> cameras,
                                        const std::vector<Posed>& views,
                                        const std::vector<std::size_t>& moment_of) {
  const std::size_t count = cameras.size();
  std::vector<std::vector<Pose>> pairs(count * count);  // [a][b]: a from b
  for (std::size_t i = 0; i < views.size(); ++i)
    for (std::size_t j = i + 1; j < views.size() && moment_of[j] == moment_of[i]; ++j) {
      const std::size_t a = views[i].view->camera, b = views[j].view->camera;
      const Pose a_from_b = views[i].camera_from_board * views[j].camera_from_board.inverse();
      pairs[a * count + b].push_back(a_from_b);
      pairs[b * count + a].push_back(a_from_b.inverse());
    }
  std::vector<std::optional<Pose>> first_from(count);
  first_from[0] = Pose{};
  for (bool grew = true; grew;) {
    grew = false;
    for (std::size_t a = 0; a < count; ++a)
      for (std::size_t b = 0; b < count; ++b) {
        if (!first_from[a] || first_from[b] || pairs[a * count + b].empty()) continue;
        first_from[b] = *first_from[a] * medoid(pairs[a * count + b]);
        grew = true;
      }
  }
  std::vector<Pose> out;
  for (std::size_t c = 0; c < count; ++c) {
    if (!first_from[c])
      return rig_undetermined(
          fmt::format("{} never sees the board at the same moment as the others: hold it where two "
                      "cameras see it",
                      cameras[c].name));
    out.push_back(*first_from[c]);
  }
  return out;
}

// Turns between neighbouring moments do not depend on where a camera sits on the body.
Result<double> find_offset(const std::vector<double>& times,
                           const std::vector<Pose>& first_from_board, const RigOptions& options) {
  constexpr double kStep = .002, kLongest = 1;  // seconds
  constexpr std::size_t kFewest = 6;
  const auto& tracker = options.tracker;
  double best = 0, smallest = std::numeric_limits<double>::infinity();
  for (double offset = -options.max_offset_s; offset <= options.max_offset_s; offset += kStep) {
    double sum = 0;
    std::size_t count = 0;
    for (std::size_t m = 1; m < times.size(); ++m) {
      if (times[m] - times[m - 1] > kLongest) continue;
      const TrackerReading from = read_tracker(tracker, times[m - 1] + offset),
                           to = read_tracker(tracker, times[m] + offset);
      if (!from.known || !to.known) continue;
      const double seen = angle_between(first_from_board[m].rotation,
                                        first_from_board[m - 1].rotation),
                   told = angle_between(to.pose.rotation, from.pose.rotation);
      sum += (seen - told) * (seen - told);
      ++count;
    }
    if (count < kFewest) continue;
    if (sum / static_cast<double>(count) < smallest)
      smallest = sum / static_cast<double>(count), best = offset;
  }
  if (!std::isfinite(smallest))
    return rig_undetermined(
        "fewer than six pairs of frames within a second of each other show the board within the "
        "tracker's times: film for longer, or use more frames (--min-interval)");
  if (std::abs(best) > options.max_offset_s - 1.5 * kStep)
    return rig_undetermined(
        fmt::format("the clocks differ by {} s or more, or the tracker follows another body: shift "
                    "its times closer to those of the frames",
                    options.max_offset_s));
  return best;
}

cv::Mat to_opencv(const glm::dmat3& m) {
  cv::Mat out(3, 3, CV_64F);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) out.at<double>(r, c) = m[c][r];
  return out;
}

// One axis leaves the camera's place along it open.
bool turns_about_two_axes(const std::vector<Pose>& world_from_body) {
  constexpr double kMin = 8 * kPi / 180;  // about the second axis, RMS
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const Pose& p : world_from_body) {
    const glm::dvec3 t = turn_of(glm::conjugate(world_from_body[0].rotation) * p.rotation);
    const Eigen::Vector3d v(t.x, t.y, t.z);
    spread += v * v.transpose() / static_cast<double>(world_from_body.size());
  }
  return std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvalues()[1]) > kMin;
}

Result<Pose> hand_eye(const std::vector<Pose>& world_from_body,
                      const std::vector<Pose>& first_from_board) {
  if (!turns_about_two_axes(world_from_body))
    return rig_undetermined(
        "the rig turns about one axis only: turn it about two, by at least 30 degrees, while it "
        "sees the board");
  std::vector<cv::Mat> body_r, body_t, board_r, board_t;
  const auto vector = [](const glm::dvec3& v) { return cv::Mat(cv::Vec3d(v.x, v.y, v.z), true); };
  for (std::size_t m = 0; m < world_from_body.size(); ++m) {
    body_r.push_back(to_opencv(world_from_body[m].rotation_matrix()));
    body_t.push_back(vector(world_from_body[m].translation));
    board_r.push_back(to_opencv(first_from_board[m].rotation_matrix()));
    board_t.push_back(vector(first_from_board[m].translation));
  }
  cv::Mat r, t;
  try {
    cv::calibrateHandEye(body_r, body_t, board_r, board_t, r, t, cv::CALIB_HAND_EYE_PARK);
  } catch (const cv::Exception& e) {
    return rig_undetermined(
        fmt::format("the pose of a camera on the tracked body cannot be found ({})", e.err));
  }
  glm::dmat3 rotation;
  for (int row = 0; row < 3; ++row)
    for (int c = 0; c < 3; ++c) rotation[c][row] = r.at<double>(row, c);
  return Pose{glm::normalize(glm::quat_cast(rotation)),
              {t.at<double>(0), t.at<double>(1), t.at<double>(2)}};
}

Result<void> place_on_body(const RigOptions& options, RigStart& start) {
  std::vector<Pose>& first_from_board = start.moments;
  PENUMBRA_ASSIGN(offset, find_offset(start.times_s, first_from_board, options));
  start.offset_s = offset;
  std::vector<Pose> known_body, known_board;  // where the tracker tells
  for (std::size_t m = 0; m < start.times_s.size(); ++m) {
    const TrackerReading now = read_tracker(options.tracker, start.times_s[m] + offset);
    if (!now.known) continue;
    known_body.push_back(now.pose);
    known_board.push_back(first_from_board[m]);
  }
  PENUMBRA_ASSIGN(body_from_first, hand_eye(known_body, known_board));
  std::vector<Pose> boards;
  for (std::size_t m = 0; m < known_body.size(); ++m)
    boards.push_back(known_body[m] * body_from_first * known_board[m]);
  start.world_from_board = medoid(boards);
  for (Pose& p : start.rig_from_camera) p = body_from_first * p;
  for (Pose& p : start.moments) p = start.world_from_board * (body_from_first * p).inverse();
  return {};
}

}  // namespace

// A parabola through the poses around the time: differences of neighbours would be mostly noise.
// Poses far off are no help, since a hand does not move along a parabola for long.
TrackerReading read_tracker(std::span<const TrackerPose> tracker, double time_s) {
  constexpr double kReach = .04;       // seconds to both sides
  constexpr double kLongestGap = .25;  // seconds that the tracker may be silent for
  constexpr std::ptrdiff_t kFewest = 3, kMax = 41;
  const auto first_of = [&](double t) {
    return std::ranges::lower_bound(tracker, t, {}, &TrackerPose::time_s) - tracker.begin();
  };
  std::ptrdiff_t first = first_of(time_s - kReach), last = first_of(time_s + kReach);
  while (last - first < kFewest && last - first < std::ssize(tracker)) {
    const bool back = last == std::ssize(tracker) ||
                      (first > 0 && time_s - tracker[static_cast<std::size_t>(first - 1)].time_s <
                                        tracker[static_cast<std::size_t>(last)].time_s - time_s);
    back ? --first : ++last;
  }
  last = std::min(last, first + kMax);
  const std::ptrdiff_t count = last - first;
  const auto around =
      tracker.subspan(static_cast<std::size_t>(first), static_cast<std::size_t>(count));
  const double from = around.front().time_s, to = around.back().time_s;
  const bool known = to - from <= kLongestGap && time_s >= from && time_s <= to;
  const Pose& middle = around[around.size() / 2].world_from_body;
  if (count < kFewest) return {middle, {}, {}, 1, known};
  Eigen::MatrixXd basis(count, 3), values(count, 6);
  for (std::ptrdiff_t i = 0; i < count; ++i) {
    const TrackerPose& p = around[static_cast<std::size_t>(i)];
    const double u = p.time_s - time_s;
    basis.row(i) << 1, u, u * u;
    const glm::dvec3 turn = turn_of(p.world_from_body.rotation * glm::conjugate(middle.rotation));
    const glm::dvec3& t = p.world_from_body.translation;
    values.row(i) << t.x, t.y, t.z, turn.x, turn.y, turn.z;
  }
  const Eigen::Matrix3d normal = basis.transpose() * basis;
  const Eigen::Matrix3d inverse = normal.inverse();
  const Eigen::MatrixXd fit = inverse * basis.transpose() * values;
  const auto vector = [&](int row, int column) {
    return glm::dvec3(fit(row, column), fit(row, column + 1), fit(row, column + 2));
  };
  const glm::dvec3 turn = vector(0, 3);
  const double angle = glm::length(turn);
  const glm::dquat moved =
      angle > 1e-12 ? glm::angleAxis(angle, turn / angle) : glm::dquat(1, 0, 0, 0);
  return {{glm::normalize(moved * middle.rotation), vector(0, 0)},
          vector(1, 0),
          vector(1, 3),
          std::sqrt(std::max(0., inverse(0, 0))),
          known};
}

namespace {

Result<void> check_tracker(std::span<const RigObservation> observations,
                           const RigOptions& options) {
  constexpr std::size_t kFewest = 10;
  const auto& tracker = options.tracker;
  if (tracker.size() < kFewest)
    return rig_undetermined(fmt::format("the tracker has {} poses, and at least {} are needed",
                                        tracker.size(), kFewest));
  if (observations.empty()) return {};
  const auto [first, last] = std::ranges::minmax(observations, {}, &RigObservation::time_s);
  const double from = tracker.front().time_s, to = tracker.back().time_s;
  if (last.time_s + options.max_offset_s < from || first.time_s - options.max_offset_s > to)
    return rig_undetermined(
        fmt::format("the tracker's times ({:.3f} to {:.3f} s) and the frames' ({:.3f} to {:.3f} s) "
                    "lie more than "
                    "{} s apart",
                    from, to, first.time_s, last.time_s, options.max_offset_s));
  return {};
}

}  // namespace

Result<RigStart> start_rig(std::span<const RigCameraInput> cameras,
                           std::span<const RigObservation> observations,
                           const RigOptions& options) {
  constexpr std::size_t kFewest = 2;
  if (!options.tracker.empty()) PENUMBRA_TRY(check_tracker(observations, options));
  std::vector<Posed> posed;
  for (const RigObservation& o : observations) {
    if (!options.tracker.empty() &&
        (o.time_s + options.max_offset_s < options.tracker.front().time_s ||
         o.time_s - options.max_offset_s > options.tracker.back().time_s))
      continue;
    if (const auto pose = board_pose(cameras[o.camera].projection, o.view))
      posed.push_back({&o, *pose});
  }
  if (posed.size() < kFewest)
    return rig_undetermined(fmt::format(
        "the board has a pose in {} pictures, and at least {} are needed", posed.size(), kFewest));
  std::ranges::stable_sort(posed, {}, [](const Posed& p) { return p.view->time_s; });
  RigStart out;
  out.moment_of = number_moments(posed, options.max_time_apart_s, out.times_s);
  PENUMBRA_ASSIGN(chained, chain_cameras(cameras, posed, out.moment_of));
  out.rig_from_camera = std::move(chained);
  out.moments.resize(out.times_s.size());
  for (std::size_t i = posed.size(); i-- > 0;)
    out.moments[out.moment_of[i]] =
        out.rig_from_camera[posed[i].view->camera] * posed[i].camera_from_board;
  for (const Posed& p : posed) out.views.push_back(*p.view);
  if (!options.tracker.empty()) PENUMBRA_TRY(place_on_body(options, out));
  return out;
}

}  // namespace penumbra::calib
