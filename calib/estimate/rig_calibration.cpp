// Corners are compared as directions, weighted by the lens's pixels per radian: one residual serves
// every projection.
#include "calib/estimate/rig_calibration.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <fmt/format.h>
#include <glog/logging.h>
#include <Eigen/Eigenvalues>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <map>
#include <numeric>

#include "calib/estimate/internal/rig_start.h"
#include "core/conventions.h"

namespace penumbra::calib {

namespace {

using PoseParameters = std::array<double, 6>;  // angle-axis, translation

PoseParameters block_of(const Pose& pose) {
  const double q[4] = {pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z};
  PoseParameters out{};
  ceres::QuaternionToAngleAxis(q, out.data());
  for (int i = 0; i < 3; ++i) out[static_cast<std::size_t>(3 + i)] = pose.translation[i];
  return out;
}

Pose pose_of(const PoseParameters& block) {
  double q[4];
  ceres::AngleAxisToQuaternion(block.data(), q);
  return {glm::normalize(glm::dquat(q[0], q[1], q[2], q[3])), {block[3], block[4], block[5]}};
}

template <class T>
void transform(const T* pose, const T* point, T* out) {
  ceres::AngleAxisRotatePoint(pose, point, out);
  for (int i = 0; i < 3; ++i) out[i] += pose[3 + i];
}

template <class T>
void transform_back(const T* pose, const T* point, T* out) {
  const T back[3] = {-pose[0], -pose[1], -pose[2]};
  const T moved[3] = {point[0] - pose[3], point[1] - pose[4], point[2] - pose[5]};
  ceres::AngleAxisRotatePoint(back, moved, out);
}

// One corner: where it is seen, and how many pixels a change of direction makes there.
struct SeenCorner {
  glm::dvec3 on_board, seen;
  double pixels[2][3];

  template <class T>
  void compare(const T* in_camera, T* residual) const {
    const T length = sqrt(in_camera[0] * in_camera[0] + in_camera[1] * in_camera[1] +
                          in_camera[2] * in_camera[2]);
    for (int r = 0; r < 2; ++r) {
      residual[r] = T(0);
      for (int i = 0; i < 3; ++i) residual[r] += pixels[r][i] * (in_camera[i] / length - seen[i]);
    }
  }
};

std::optional<SeenCorner> corner_of(const CameraModel& projection, glm::dvec2 pixel,
                                    glm::dvec2 board) {
  const auto seen = direction_from_pixel(projection, pixel);
  if (!seen) return std::nullopt;
  SeenCorner out{{board.x, -board.y, 0}, *seen, {}};
  // Two directions at right angles to it; what they move the pixel by.
  const glm::dvec3 any = std::abs(seen->z) < .9 ? glm::dvec3(0, 0, 1) : glm::dvec3(1, 0, 0);
  const glm::dvec3 u = glm::normalize(glm::cross(*seen, any)), v = glm::cross(*seen, u);
  constexpr double kStep = 1e-5;  // radian
  for (const glm::dvec3& side : {u, v}) {
    const auto ahead = pixel_from_direction(projection, glm::normalize(*seen + kStep * side)),
               behind = pixel_from_direction(projection, glm::normalize(*seen - kStep * side));
    if (!ahead || !behind) return std::nullopt;
    const glm::dvec2 slope = (*ahead - *behind) / (2 * kStep);
    for (int r = 0; r < 2; ++r)
      for (int i = 0; i < 3; ++i) out.pixels[r][i] += slope[r] * side[i];
  }
  return out;
}

// Board fixed to nothing: its pose in the rig at each moment.
struct FreeBoard {
  SeenCorner corner;
  double weight;
  template <class T>
  bool operator()(const T* rig_from_camera, const T* rig_from_board, T* residual) const {
    const T p[3] = {T(corner.on_board.x), T(corner.on_board.y), T(corner.on_board.z)};
    T in_rig[3], in_camera[3];
    transform(rig_from_board, p, in_rig);
    transform_back(rig_from_camera, in_rig, in_camera);
    corner.compare(in_camera, residual);
    for (int r = 0; r < 2; ++r) residual[r] *= weight;
    return true;
  }
};

// Board fixed in the tracker's world.
struct FixedBoard {
  SeenCorner corner;
  double weight;
  template <class T>
  bool operator()(const T* body_from_camera, const T* world_from_body, const T* world_from_board,
                  const T* scale, T* residual) const {
    const T p[3] = {*scale * corner.on_board.x, *scale * corner.on_board.y,
                    *scale * corner.on_board.z};
    T in_world[3], in_body[3], in_camera[3];
    transform(world_from_board, p, in_world);
    transform_back(world_from_body, in_world, in_body);
    transform_back(body_from_camera, in_body, in_camera);
    corner.compare(in_camera, residual);
    for (int r = 0; r < 2; ++r) residual[r] *= weight;
    return true;
  }
};

// What the tracker says of the body at a moment, to first order in a change of the clocks' offset.
struct Tracked {
  Pose pose;
  glm::dvec3 velocity, turning;  // metres and radian a second, in the world
  double offset_s;               // at which they were read
  double weight_m, weight_rad;

  template <class T>
  bool operator()(const T* world_from_body, const T* offset, T* residual) const {
    const T late = offset[0] - offset_s;
    for (int i = 0; i < 3; ++i)
      residual[i] =
          weight_m * (world_from_body[3 + i] - (pose.translation[i] + late * velocity[i]));
    const T turn[3] = {late * turning.x, late * turning.y, late * turning.z};
    T moved[4], told[4], own[4], difference[4], out[3];
    const T measured[4] = {T(pose.rotation.w), T(pose.rotation.x), T(pose.rotation.y),
                           T(pose.rotation.z)};
    ceres::AngleAxisToQuaternion(turn, moved);
    ceres::QuaternionProduct(moved, measured, told);
    ceres::AngleAxisToQuaternion(world_from_body, own);
    const T back[4] = {told[0], -told[1], -told[2], -told[3]};
    ceres::QuaternionProduct(own, back, difference);
    ceres::QuaternionToAngleAxis(difference, out);
    for (int i = 0; i < 3; ++i) residual[3 + i] = weight_rad * out[i];
    return true;
  }
};

// Focal lengths, principal point and, where they count, all terms of the distortion.
Result<void> check_lens_covariance(const RigCameraInput& camera) {
  const std::vector<double>& v = camera.lens_covariance;
  const auto all = static_cast<std::size_t>(4 + distortion_count(camera.projection.kind));
  if (!v.empty() && v.size() != 16 && v.size() != all * all)
    return fail(ErrorCode::kInvalid, camera.name,
                fmt::format("has a lens covariance of {} numbers instead of 16 or {}", v.size(),
                            all * all));
  for (const double x : v)
    if (!std::isfinite(x))
      return fail(ErrorCode::kNonFinite, camera.name, "has a lens covariance that is not finite");
  if (v.empty()) return {};
  constexpr double kRounding = 1e-6;
  const auto n = static_cast<Eigen::Index>(std::lround(std::sqrt(v.size())));
  const Eigen::Map<const Eigen::MatrixXd> covariance(v.data(), n, n);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> axes(covariance, Eigen::EigenvaluesOnly);
  const double largest = covariance.cwiseAbs().maxCoeff();
  if ((covariance - covariance.transpose()).cwiseAbs().maxCoeff() > kRounding * largest ||
      axes.eigenvalues().minCoeff() < -kRounding * largest)
    return fail(ErrorCode::kInvalid, camera.name,
                "has a lens covariance that is not symmetric or has negative variances");
  return {};
}

// A lens moved by one standard deviation along each axis of its uncertainty.
std::vector<CameraModel> moved_lenses(const RigCameraInput& camera) {
  const int n = static_cast<int>(std::lround(std::sqrt(camera.lens_covariance.size())));
  const Eigen::Map<const Eigen::MatrixXd> covariance(camera.lens_covariance.data(), n, n);
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> axes(covariance);
  std::vector<CameraModel> out;
  for (int k = 0; k < n; ++k) {
    const Eigen::VectorXd step =
        std::sqrt(std::max(0., axes.eigenvalues()[k])) * axes.eigenvectors().col(k);
    if (!(step.squaredNorm() > 0)) continue;
    CameraModel& lens = out.emplace_back(camera.projection);
    for (int i = 0; i < 2; ++i) lens.focal_px[i] += step[i], lens.principal_px[i] += step[2 + i];
    for (int i = 4; i < n; ++i) lens.distortion[static_cast<std::size_t>(i - 4)] += step[i];
  }
  return out;
}

class Adjustment {
 public:
  Adjustment(std::span<const RigCameraInput> cameras, std::span<const RigObservation> views,
             const RigOptions& options, const RigStart& start)
      : options_(options), start_(start), used_(views.size(), true) {
    for (const Pose& p : start.rig_from_camera) cameras_.push_back(block_of(p));
    for (const Pose& p : start.moments) moments_.push_back(block_of(p));
    world_from_board_ = block_of(start.world_from_board);
    offset_s_ = start.offset_s;
    for (const RigObservation& o : views)
      observed_.push_back({o.camera, start.moment_of[observed_.size()],
                           corners_of(cameras[o.camera].projection, o.view)});
  }

  Result<RigCalibration> run(std::span<const RigCameraInput> cameras,
                             std::span<const RigObservation> views) {
    constexpr int kPasses = 4;
    for (int pass = 0; pass < kPasses; ++pass) {
      ceres::Problem problem;
      build(problem, true);
      if (!solve(problem)) return rig_undetermined("the least-squares solution does not converge");
      sigma_px_ = std::max(.01, rms());
      if (pass < kPasses - 1) leave_out();
    }
    RigCalibration out;
    out.rms_px = rms();
    for (std::size_t v = 0; v < views.size(); ++v)
      if (!used_[v]) out.left_out.push_back(views[v].view.name);
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      out.cameras.push_back({pose_of(cameras_[c]), {}, {}, rms(c), boards(c)});
      if (out.cameras[c].boards == 0)
        return rig_undetermined(
            fmt::format("no picture of the board by {} agrees with the others", cameras[c].name));
    }
    PENUMBRA_TRY(check_fit(out));
    set_boards(out);
    if (tracked()) {
      out.tracker_offset_s = offset_s_;
      PENUMBRA_TRY(check_scale(cameras, views, out));
    }
    PENUMBRA_TRY(add_lens_uncertainty(cameras, views));
    PENUMBRA_TRY(estimate_sigmas(out));
    return out;
  }

 private:
  using Covariance6 = std::array<double, 36>;

  static std::vector<SeenCorner> corners_of(const CameraModel& lens, const BoardView& view) {
    std::vector<SeenCorner> out;
    for (std::size_t i = 0; i < view.pixels.size(); ++i)
      if (const auto c = corner_of(lens, view.pixels[i], view.on_board_m[i])) out.push_back(*c);
    return out;
  }

  // With another lens of a camera, from where it is; nothing where that does not converge.
  std::optional<Adjustment> solved_with(const CameraModel& lens, std::size_t camera,
                                        std::span<const RigObservation> views) const {
    Adjustment out = *this;
    for (std::size_t v = 0; v < views.size(); ++v)
      if (observed_[v].camera == camera) out.observed_[v].corners = corners_of(lens, views[v].view);
    ceres::Problem problem;
    out.build(problem, true);
    if (!solve(problem)) return std::nullopt;
    return out;
  }

  // With each lens moved along each axis of its uncertainty the rig is solved anew from where it
  // is. What the poses move by are the columns of a root of what the lenses add.
  Result<void> add_lens_uncertainty(std::span<const RigCameraInput> cameras,
                                    std::span<const RigObservation> views) {
    lens_part_.assign(cameras_.size(), {});
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      if (cameras[c].lens_covariance.empty()) continue;
      for (const CameraModel& lens : moved_lenses(cameras[c])) {
        const auto moved = solved_with(lens, c, views);
        if (!moved)
          return rig_undetermined(
              fmt::format("the lens of {} is too uncertain to say how sure its pose "
                          "is: calibrate it better",
                          cameras[c].name));
        for (std::size_t k = 0; k < cameras_.size(); ++k)
          for (std::size_t i = 0; i < 36; ++i)
            lens_part_[k][i] += (moved->cameras_[k][i / 6] - cameras_[k][i / 6]) *
                                (moved->cameras_[k][i % 6] - cameras_[k][i % 6]);
        lens_part_of_offset_ += (moved->offset_s_ - offset_s_) * (moved->offset_s_ - offset_s_);
      }
    }
    return {};
  }

  struct Observed {
    std::size_t camera, moment;
    std::vector<SeenCorner> corners;
  };
  bool tracked() const { return !options_.tracker.empty(); }

  void build(ceres::Problem& problem, bool robust) {
    constexpr double kHuber = 2;  // standard deviations
    const double weight = 1 / sigma_px_;
    const auto loss = [&] { return robust ? new ceres::HuberLoss(kHuber) : nullptr; };
    for (std::size_t v = 0; v < observed_.size(); ++v) {
      Observed& o = observed_[v];
      if (!used_[v]) continue;
      for (const SeenCorner& corner : o.corners) {
        if (tracked())
          problem.AddResidualBlock(new ceres::AutoDiffCostFunction<FixedBoard, 2, 6, 6, 6, 1>(
                                       new FixedBoard{corner, weight}),
                                   loss(), cameras_[o.camera].data(), moments_[o.moment].data(),
                                   world_from_board_.data(), &board_scale_);
        else
          problem.AddResidualBlock(
              new ceres::AutoDiffCostFunction<FreeBoard, 2, 6, 6>(new FreeBoard{corner, weight}),
              loss(), cameras_[o.camera].data(), moments_[o.moment].data());
      }
    }
    if (!tracked()) {
      if (problem.HasParameterBlock(cameras_[0].data()))
        problem.SetParameterBlockConstant(cameras_[0].data());
      return;
    }
    if (!scale_is_free_ && problem.HasParameterBlock(&board_scale_))
      problem.SetParameterBlockConstant(&board_scale_);
    for (std::size_t m = 0; m < moments_.size(); ++m) {
      if (!problem.HasParameterBlock(moments_[m].data())) continue;
      const TrackerReading now = read_tracker(options_.tracker, start_.times_s[m] + offset_s_);
      if (!now.known) continue;
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Tracked, 6, 6, 1>(
                                   new Tracked{now.pose, now.velocity, now.turning, offset_s_,
                                               1 / (now.noise * options_.tracker_sigma_m),
                                               1 / (now.noise * options_.tracker_sigma_rad)}),
                               nullptr, moments_[m].data(), &offset_s_);
    }
  }

  static bool solve(ceres::Problem& problem) {
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_SCHUR;
    options.max_num_iterations = 100;
    options.function_tolerance = 1e-10;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable();
  }

  // Sum of the corners' squared distances, and their number.
  std::pair<double, std::size_t> squares(std::size_t v) const {
    const Observed& o = observed_[v];
    double sum = 0;
    for (const SeenCorner& corner : o.corners) {
      double r[2];
      if (tracked())
        FixedBoard{corner, 1}(cameras_[o.camera].data(), moments_[o.moment].data(),
                              world_from_board_.data(), &board_scale_, r);
      else
        FreeBoard{corner, 1}(cameras_[o.camera].data(), moments_[o.moment].data(), r);
      sum += r[0] * r[0] + r[1] * r[1];
    }
    return {sum, o.corners.size()};
  }
  // Of the usual one of the tracker's poses, in their own standard deviations.
  double tracker_misfit() const {
    std::vector<double> all;
    for (std::size_t m = 0; m < moments_.size(); ++m) {
      const TrackerReading now = read_tracker(options_.tracker, start_.times_s[m] + offset_s_);
      if (!now.known) continue;
      double r[6], sum = 0;
      Tracked{now.pose,
              now.velocity,
              now.turning,
              offset_s_,
              1 / (now.noise * options_.tracker_sigma_m),
              1 / (now.noise * options_.tracker_sigma_rad)}(moments_[m].data(), &offset_s_, r);
      for (const double v : r) sum += v * v / 6;
      all.push_back(std::sqrt(sum));
    }
    if (all.empty()) return 0;
    std::ranges::nth_element(all, all.begin() + std::ssize(all) / 2);
    return all[all.size() / 2];
  }
  Result<void> check_fit(const RigCalibration& out) const {
    constexpr double kMax_px = 2, kMaxSigmas = 3;
    if (out.rms_px > kMax_px || 3 * out.left_out.size() > observed_.size())
      return rig_undetermined(fmt::format(
          "the pictures of the board contradict each other ({:.1f} px RMS, {} of {} left out): is "
          "the size in --board right, were the frames of a moment taken at once, and are the "
          "lenses calibrated{}?",
          out.rms_px, out.left_out.size(), observed_.size(),
          tracked() ? ", did the board stand still, and are the quaternions x, y, z, w" : ""));
    const double sigmas = tracked() ? tracker_misfit() : 0;
    if (sigmas > kMaxSigmas)
      return rig_undetermined(
          fmt::format("the tracker contradicts the cameras by {:.1f} times its stated noise: are "
                      "its metres and quaternions (x, y, z, w) and the size in --board right, and "
                      "did the board stand still?",
                      sigmas));
    return {};
  }
  // The tracker's metres are a second measure of the board: solved anew with its size left open. A
  // lens whose focal length is off looks alike, so what its calibration leaves open counts, and
  // where nothing is said of that, a part that careless ones have.
  Result<void> check_scale(std::span<const RigCameraInput> cameras,
                           std::span<const RigObservation> views, RigCalibration& out) const {
    constexpr double kMaxOff = .01, kMaxOffOfUnknown = .025, kMaxSigmas = 4;
    Adjustment open = *this;
    open.scale_is_free_ = true;
    {
      ceres::Problem problem;
      open.build(problem, true);
      if (!solve(problem)) return {};
    }
    open.sigma_px_ = std::max(.01, open.rms());
    ceres::Problem problem;
    open.build(problem, false);
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(options);
    const double* const scale = &open.board_scale_;
    const std::vector<std::pair<const double*, const double*>> wanted{{scale, scale}};
    if (!covariance.Compute(wanted, &problem)) return {};
    double variance = 0;
    covariance.GetCovarianceBlock(scale, scale, &variance);
    double by_lenses = 0;
    bool all_known = true;
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      all_known &= !cameras[c].lens_covariance.empty();
      if (cameras[c].lens_covariance.empty()) continue;
      for (const CameraModel& lens : moved_lenses(cameras[c]))
        if (const auto moved = open.solved_with(lens, c, views))
          by_lenses += std::pow(moved->board_scale_ - open.board_scale_, 2);
    }
    out.board_scale = open.board_scale_;
    out.board_scale_sigma = std::sqrt(std::max(0., variance) + by_lenses);
    const double off = open.board_scale_ - 1;
    if (std::abs(off) >
        std::max(all_known ? kMaxOff : kMaxOffOfUnknown, kMaxSigmas * out.board_scale_sigma))
      return rig_undetermined(fmt::format(
          "by the tracker's metres the board is {:.3f} +- {:.3f} times as large as --board says: "
          "measure its squares; a focal length that is off as much, or the tracker's unit, would "
          "look alike",
          open.board_scale_, out.board_scale_sigma));
    return {};
  }
  void set_boards(RigCalibration& out) const {
    std::vector<bool> seen(moments_.size(), false);
    for (std::size_t v = 0; v < observed_.size(); ++v)
      if (used_[v]) seen[observed_[v].moment] = true;
    for (std::size_t m = 0; m < moments_.size(); ++m)
      if (seen[m])
        out.rig_from_board.push_back(
            {start_.times_s[m], tracked()
                                    ? pose_of(moments_[m]).inverse() * pose_of(world_from_board_)
                                    : pose_of(moments_[m])});
  }

  // Of a coordinate, pixels.
  double rms(std::optional<std::size_t> camera = {}) const {
    double sum = 0;
    std::size_t count = 0;
    for (std::size_t v = 0; v < observed_.size(); ++v) {
      if (!used_[v] || (camera && observed_[v].camera != *camera)) continue;
      const auto [square, corners] = squares(v);
      sum += square, count += corners;
    }
    return count ? std::sqrt(sum / (2. * static_cast<double>(count))) : 0;
  }
  std::size_t boards(std::size_t camera) const {
    std::size_t out = 0;
    for (std::size_t v = 0; v < observed_.size(); ++v)
      out += used_[v] && observed_[v].camera == camera;
    return out;
  }

  // Boards three times as far off as the usual one; of a moment the farthest, for it bends the
  // others.
  void leave_out() {
    constexpr double kTimes = 3, kMin_px = .5;
    std::vector<double> all;
    std::map<std::size_t, std::pair<double, std::size_t>> farthest;  // by moment: pixels, view
    for (std::size_t v = 0; v < observed_.size(); ++v) {
      if (!used_[v]) continue;
      const auto [square, corners] = squares(v);
      all.push_back(
          std::sqrt(square / (2. * static_cast<double>(std::max<std::size_t>(corners, 1)))));
      auto& worst = farthest[observed_[v].moment];
      worst = std::max(worst, std::pair(all.back(), v));
    }
    std::ranges::nth_element(all, all.begin() + std::ssize(all) / 2);
    const double largest = std::max(kMin_px, kTimes * all[all.size() / 2]);
    for (const auto& [moment, worst] : farthest)
      if (worst.first > largest) used_[worst.second] = false;
  }

  // Along the rig's axes. A small turn of the angle-axis numbers is turned into one of the rotation
  // by differences.
  static void set_sigmas(const PoseParameters& block, const double* covariance,
                         RigCameraPose& out) {
    const Pose pose = pose_of(block);
    glm::dmat3 turn;
    constexpr double kStep = 1e-6;
    for (std::size_t i = 0; i < 3; ++i) {
      PoseParameters moved = block;
      moved[i] += kStep;
      const glm::dquat d = pose_of(moved).rotation * glm::conjugate(pose.rotation);
      turn[static_cast<int>(i)] = 2. / kStep * glm::dvec3(d.x, d.y, d.z) * (d.w < 0 ? -1. : 1.);
    }
    glm::dmat3 rotation;
    for (int c = 0; c < 3; ++c)
      for (int r = 0; r < 3; ++r) rotation[c][r] = covariance[6 * r + c];
    const glm::dmat3 turned = turn * rotation * glm::transpose(turn);
    for (int i = 0; i < 3; ++i) {
      out.rotation_sigma_rad[i] = std::sqrt(std::max(0., turned[i][i]));
      out.position_sigma_m[i] = std::sqrt(std::max(0., covariance[6 * (3 + i) + 3 + i]));
    }
  }

  Result<void> set_offset_sigma(ceres::Covariance& covariance, RigCalibration& out) const {
    constexpr double kMaxOffsetSigma = .005;
    double variance = 0;
    covariance.GetCovarianceBlock(&offset_s_, &offset_s_, &variance);
    out.tracker_offset_sigma_s = std::sqrt(std::max(0., variance) + lens_part_of_offset_);
    if (out.tracker_offset_sigma_s > kMaxOffsetSigma && lens_part_of_offset_ > variance)
      return rig_undetermined(
          fmt::format("the offset between the clocks stays uncertain by {:.0f} ms: calibrate the "
                      "lenses better",
                      1000 * out.tracker_offset_sigma_s));
    if (out.tracker_offset_sigma_s > kMaxOffsetSigma)
      return rig_undetermined(
          fmt::format("the offset between the clocks stays uncertain by {:.0f} ms: move the rig "
                      "faster, by half a metre and 30 degrees a second",
                      1000 * out.tracker_offset_sigma_s));
    return {};
  }

  // Of a pose; radians count as metres.
  static double variance(const double* block) {
    double sum = 0;
    for (std::size_t i = 0; i < 6; ++i) sum += block[7 * i];
    return sum;
  }

  Result<void> estimate_sigmas(RigCalibration& out) {
    constexpr double kMaxPosition_m = .05, kMaxTurn = .02;
    ceres::Problem problem;
    build(problem, false);
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(options);
    std::vector<std::pair<const double*, const double*>> wanted;
    for (std::size_t c = tracked() ? 0 : 1; c < cameras_.size(); ++c)
      wanted.emplace_back(cameras_[c].data(), cameras_[c].data());
    if (tracked()) wanted.emplace_back(&offset_s_, &offset_s_);
    if (wanted.empty()) return {};
    if (!covariance.Compute(wanted, &problem))
      return rig_undetermined(tracked()
                                  ? "the poses are not determined: turn the rig about two axes, "
                                    "by at least 30 degrees, while it sees the board"
                                  : "the poses are not determined: show the board closer");
    if (tracked()) PENUMBRA_TRY(set_offset_sigma(covariance, out));
    for (std::size_t c = tracked() ? 0 : 1; c < cameras_.size(); ++c) {
      double block[36];
      covariance.GetCovarianceBlock(cameras_[c].data(), cameras_[c].data(), block);
      const bool by_lenses = variance(lens_part_[c].data()) > variance(block);
      for (std::size_t i = 0; i < 36; ++i) block[i] += lens_part_[c][i];
      set_sigmas(cameras_[c], block, out.cameras[c]);
      const double place = glm::length(out.cameras[c].position_sigma_m),
                   turn = glm::length(out.cameras[c].rotation_sigma_rad);
      if (place > kMaxPosition_m || turn > kMaxTurn)
        return rig_undetermined(
            fmt::format("the pose of a camera stays uncertain by {:.0f} mm and {:.1f} degrees: {}",
                        1000 * place, turn * 180 / kPi,
                        by_lenses   ? "calibrate the lenses better"
                        : tracked() ? "turn the rig about two axes, by at least 30 degrees"
                                    : "show the board closer, tilted, to both cameras at once"));
    }
    return {};
  }

  const RigOptions& options_;
  const RigStart& start_;
  std::vector<PoseParameters> cameras_,
      moments_;  // rig_from_camera; rig_from_board or world_from_body
  PoseParameters world_from_board_{};
  double offset_s_ = 0, sigma_px_ = .3;
  double board_scale_ = 1;  // over its told size
  bool scale_is_free_ = false;
  std::vector<Observed> observed_;
  std::vector<bool> used_;
  std::vector<Covariance6> lens_part_;  // of the poses' covariances, by camera
  double lens_part_of_offset_ = 0;
};

}  // namespace

Result<RigCalibration> calibrate_rig(std::span<const RigCameraInput> cameras,
                                     std::span<const RigObservation> observations,
                                     const RigOptions& options) {
  if (cameras.empty()) return fail(ErrorCode::kInvalid, "rig calibration", "there is no camera");
  FLAGS_minloglevel = google::GLOG_FATAL;  // Ceres' own words; what matters comes back as errors
  for (const RigCameraInput& c : cameras) PENUMBRA_TRY(check_lens_covariance(c));
  for (const RigObservation& o : observations)
    if (o.camera >= cameras.size())
      return fail(ErrorCode::kInvalid, o.view.name, "belongs to a camera that does not exist");
  for (std::size_t i = 1; i < options.tracker.size(); ++i)
    if (!(options.tracker[i].time_s > options.tracker[i - 1].time_s))
      return fail(ErrorCode::kInvalid, fmt::format("tracker pose {}", i + 1),
                  "is not later than the one before");
  PENUMBRA_ASSIGN(start, start_rig(cameras, observations, options));
  Adjustment adjustment(cameras, start.views, options, start);
  return adjustment.run(cameras, start.views);
}

}  // namespace penumbra::calib
