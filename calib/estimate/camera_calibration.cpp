// Inside this file the camera looks along +z with y down, and so does the board: the pictures' own
// axes. Calls OpenCV for the first guess of a board's pose; its exceptions end here.
#include "calib/estimate/camera_calibration.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <optional>

#include "core/conventions.h"

namespace penumbra::calib {
namespace {

constexpr int kShared = 4;  // fx fy cx cy, before the distortion
constexpr std::size_t kMinBoards = 3;

using Pose6 = std::array<double, 6>;  // camera from board: angle-axis, translation

// ------------------------------------------------------------------------------- lenses

template <class T>
T radius(const T& x, const T& y) {
  return sqrt(x * x + y * y + 1e-24);  // has a slope at 0
}

struct Equidistant {
  static constexpr int kDistortion = 0;
  template <class T>
  static void normalised(const T* /*k*/, const T* p, T* q) {
    const T r = radius(p[0], p[1]), scale = atan2(r, p[2]) / r;
    q[0] = p[0] * scale;
    q[1] = p[1] * scale;
  }
};

struct KannalaBrandt {
  static constexpr int kDistortion = 4;
  template <class T>
  static void normalised(const T* k, const T* p, T* q) {
    const T r = radius(p[0], p[1]), theta = atan2(r, p[2]), t = theta * theta;
    const T scale = theta * (1. + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])))) / r;
    q[0] = p[0] * scale;
    q[1] = p[1] * scale;
  }
};

struct DoubleSphere {
  static constexpr int kDistortion = 2;
  template <class T>
  static void normalised(const T* k, const T* p, T* q) {
    const T r2 = p[0] * p[0] + p[1] * p[1];
    const T z = k[0] * sqrt(r2 + p[2] * p[2]) + p[2];
    // Times 1 + xi: the slope at the centre is 1, so that the focal length found does not hang on
    // xi, which alone is loosely known (of_paper() turns it back).
    const T scale = (1. + k[0]) / (k[1] * sqrt(r2 + z * z) + (1. - k[1]) * z);
    q[0] = p[0] * scale;
    q[1] = p[1] * scale;
  }
};

struct Pinhole {
  static constexpr int kDistortion = 5;
  template <class T>
  static void normalised(const T* k, const T* p, T* q) {
    const T x = p[0] / p[2], y = p[1] / p[2], r2 = x * x + y * y;
    const T radial = 1. + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    q[0] = x * radial + 2. * k[2] * x * y + k[3] * (r2 + 2. * x * x);
    q[1] = y * radial + k[2] * (r2 + 2. * y * y) + 2. * k[3] * x * y;
  }
};

template <class Lens>
struct BoardCorner {
  glm::dvec2 pixel, board;
  template <class T>
  bool operator()(const T* intrinsics, const T* pose, T* residual) const {
    const T on_board[3] = {T(board.x), T(board.y), T(0)};
    T p[3], q[2];
    ceres::AngleAxisRotatePoint(pose, on_board, p);
    for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];
    Lens::normalised(intrinsics + kShared, p, q);
    for (int i = 0; i < 2; ++i) residual[i] = pixel[i] - (intrinsics[2 + i] + intrinsics[i] * q[i]);
    return true;
  }
};

// ------------------------------------------------------------------------------- first guess

// The angle from the axis at normalised radius rho, before anything is known of the distortion.
double guessed_theta(ProjectionKind kind, double rho) {
  if (kind == ProjectionKind::kPinhole) return std::atan(rho);
  if (kind == ProjectionKind::kDoubleSphere) return 2 * std::atan(rho / 2);  // xi 0, alpha 1/2
  return rho;
}

struct LensGuess {
  double focal = 0;
  std::vector<std::optional<Pose6>> poses;
  double cost = HUGE_VAL;  // of the corners near the axis, in pixels
};

// A board's pose from its corners within 70 degrees of the axis, as if a pinhole had seen their
// directions.
std::optional<std::pair<Pose6, double>> guess_pose(const BoardView& view, ProjectionKind kind,
                                                   glm::dvec2 centre, double focal) {
  constexpr double kWidest = 70 * kPi / 180;
  std::vector<cv::Point3f> board;
  std::vector<cv::Point2f> seen;
  for (std::size_t i = 0; i < view.pixels.size(); ++i) {
    const glm::dvec2 q = (view.pixels[i] - centre) / focal;
    const double rho = glm::length(q), theta = guessed_theta(kind, rho);
    if (theta > kWidest) continue;
    const glm::dvec2 plane = rho > 0 ? q * (std::tan(theta) / rho) : q;
    board.emplace_back(static_cast<float>(view.on_board_m[i].x),
                       static_cast<float>(view.on_board_m[i].y), 0.f);
    seen.emplace_back(static_cast<float>(plane.x), static_cast<float>(plane.y));
  }
  if (board.size() < 6) return std::nullopt;
  cv::Mat rotation, translation;
  std::vector<cv::Point2f> back;
  try {
    if (!cv::solvePnP(board, seen, cv::Mat::eye(3, 3, CV_64F), cv::noArray(), rotation, translation,
                      false, cv::SOLVEPNP_IPPE))
      return std::nullopt;
    cv::projectPoints(board, rotation, translation, cv::Mat::eye(3, 3, CV_64F), cv::noArray(),
                      back);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  double sum = 0;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    // Back to angles, so that corners far from the axis do not count more.
    const auto angle = [](const cv::Point2f& p) {
      const double r = std::hypot(p.x, p.y);
      return glm::dvec2(p.x, p.y) * (r > 0 ? std::atan(r) / r : 1);
    };
    const glm::dvec2 off = angle(seen[i]) - angle(back[i]);
    sum += focal * focal * glm::dot(off, off);
  }
  Pose6 pose{};
  for (int i = 0; i < 3; ++i) {
    pose[static_cast<std::size_t>(i)] = rotation.at<double>(i);
    pose[static_cast<std::size_t>(3 + i)] = translation.at<double>(i);
  }
  if (!(pose[5] > 0)) return std::nullopt;
  return std::pair{pose, sum / static_cast<double>(seen.size())};
}

LensGuess guess_at(std::span<const BoardView> views, ProjectionKind kind, glm::dvec2 centre,
                   double focal) {
  LensGuess out{.focal = focal, .poses = {}};
  std::vector<double> costs;
  for (const BoardView& view : views) {
    const auto pose = guess_pose(view, kind, centre, focal);
    out.poses.push_back(pose ? std::optional(pose->first) : std::nullopt);
    if (pose) costs.push_back(pose->second);
  }
  if (costs.size() * 2 < views.size() || costs.size() < kMinBoards) return out;
  std::ranges::nth_element(costs, costs.begin() + static_cast<std::ptrdiff_t>(costs.size() / 2));
  out.cost = costs[costs.size() / 2];
  return out;
}

LensGuess best_guess(std::span<const BoardView> views, ProjectionKind kind, int width, int height) {
  LensGuess best;
  constexpr double kShortest = .15, kLongest = 4, kStep = 1.15;  // of the picture's width
  for (double fraction = kShortest; fraction < kLongest; fraction *= kStep) {
    LensGuess guess = guess_at(views, kind, {width / 2., height / 2.}, fraction * width);
    if (guess.cost < best.cost) best = std::move(guess);
  }
  return best;
}

// ------------------------------------------------------------------------------- refinement

struct LensFit {
  std::vector<double> intrinsics;
  std::vector<std::optional<Pose6>> poses;
  std::vector<double> covariance;  // of the intrinsics, row by row
  [[nodiscard]] double sigma(std::size_t i) const {
    return std::sqrt(std::max(0., covariance[i * intrinsics.size() + i]));
  }
};

template <class Lens>
class Solver {
 public:
  /// `fixed`: terms of the distortion that stay at 0.
  Solver(std::span<const BoardView> views, LensFit& fit, std::span<const int> fixed)
      : views_(views), fit_(fit) {
    for (const int term : fixed) fixed_.push_back(kShared + term);
  }

  // False when it does not converge to something finite.
  bool solve(double huber_px, const std::vector<bool>& used) {
    ceres::Problem problem;
    add(problem, huber_px, used);
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.max_num_iterations = 200;
    options.function_tolerance = 1e-12;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable() &&
           std::ranges::all_of(fit_.intrinsics, [](double v) { return std::isfinite(v); });
  }

  // False when the boards leave a direction free.
  bool estimate_covariance(double residual_variance, const std::vector<bool>& used) {
    ceres::Problem problem;
    add(problem, 0, used);
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(options);
    double* const block = fit_.intrinsics.data();
    const std::vector<std::pair<const double*, const double*>> wanted{{block, block}};
    if (!covariance.Compute(wanted, &problem)) return false;
    std::vector<double> values(kCount * kCount);
    if (!covariance.GetCovarianceBlock(block, block, values.data())) return false;
    for (double& v : values) v *= residual_variance;
    fit_.covariance = std::move(values);
    return true;
  }

  std::vector<glm::dvec2> residuals(std::size_t board) const {
    std::vector<glm::dvec2> out;
    for (std::size_t i = 0; i < views_[board].pixels.size(); ++i) {
      glm::dvec2 off;
      const BoardCorner<Lens> corner{views_[board].pixels[i], views_[board].on_board_m[i]};
      corner(fit_.intrinsics.data(), fit_.poses[board]->data(), &off.x);
      out.push_back(off);
    }
    return out;
  }

 private:
  static constexpr std::size_t kCount = kShared + Lens::kDistortion;

  void add(ceres::Problem& problem, double huber_px, const std::vector<bool>& used) {
    double* const intrinsics = fit_.intrinsics.data();
    for (std::size_t b = 0; b < views_.size(); ++b) {
      if (!used[b]) continue;
      for (std::size_t i = 0; i < views_[b].pixels.size(); ++i) {
        auto* const cost = new ceres::AutoDiffCostFunction<BoardCorner<Lens>, 2, kCount, 6>(
            new BoardCorner<Lens>{views_[b].pixels[i], views_[b].on_board_m[i]});
        problem.AddResidualBlock(cost, huber_px > 0 ? new ceres::HuberLoss(huber_px) : nullptr,
                                 intrinsics, fit_.poses[b]->data());
      }
    }
    if (!fixed_.empty()) {
      problem.SetManifold(intrinsics, new ceres::SubsetManifold(kCount, fixed_));
    } else if (std::is_same_v<Lens, DoubleSphere>) {
      constexpr double kInside = .999;
      problem.SetParameterLowerBound(intrinsics, kShared, -kInside);
      problem.SetParameterUpperBound(intrinsics, kShared, kInside);
      problem.SetParameterLowerBound(intrinsics, kShared + 1, 1 - kInside);
      problem.SetParameterUpperBound(intrinsics, kShared + 1, kInside);
    }
  }

  std::span<const BoardView> views_;
  LensFit& fit_;
  std::vector<int> fixed_;  // of the intrinsics
};

// ------------------------------------------------------------------------------- the whole

std::unexpected<Error> lens_undetermined(std::string detail) {
  return fail(ErrorCode::kUndetermined, "camera calibration", std::move(detail));
}

double rms(std::span<const glm::dvec2> residuals) {
  double sum = 0;
  for (const glm::dvec2& r : residuals) sum += glm::dot(r, r);
  return residuals.empty() ? 0 : std::sqrt(sum / static_cast<double>(residuals.size()));
}

Pose in_our_axes(const Pose6& pose) {
  double m[9];
  ceres::AngleAxisToRotationMatrix(pose.data(), m);  // column-major
  glm::dmat3 r(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]);
  const glm::dvec3 flip(1, -1, -1);
  for (int c = 0; c < 3; ++c) r[c] = flip * r[c] * flip[c];
  return {glm::normalize(glm::quat_cast(r)), flip * glm::dvec3(pose[3], pose[4], pose[5])};
}

void measure_spread(std::span<const BoardView> views, CameraCalibration& out) {
  constexpr int kColumns = 8, kRows = 6;
  std::array<bool, kColumns * kRows> hit{};
  const double width = out.projection.width, height = out.projection.height;
  for (std::size_t b = 0; b < views.size(); ++b) {
    if (!out.boards[b].used) continue;
    for (const glm::dvec2& p : views[b].pixels) {
      out.reach = std::max(out.reach, glm::length(p - glm::dvec2(width, height) / 2.) /
                                          (std::hypot(width, height) / 2));
      const int x = std::clamp(static_cast<int>(p.x / width * kColumns), 0, kColumns - 1);
      const int y = std::clamp(static_cast<int>(p.y / height * kRows), 0, kRows - 1);
      hit[static_cast<std::size_t>(y * kColumns + x)] = true;
    }
  }
  out.coverage = static_cast<double>(std::ranges::count(hit, true)) / hit.size();
}

// Boards whose corners contradict the others: three times their usual distance off.
void leave_out(CameraCalibration& out, std::vector<bool>& used) {
  std::vector<double> distances;
  for (std::size_t b = 0; b < used.size(); ++b)
    if (used[b]) distances.push_back(out.boards[b].rms_px);
  std::ranges::nth_element(distances,
                           distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2));
  constexpr double kTimes = 3, kMinPx = .5;
  const double largest = std::max(kMinPx, kTimes * distances[distances.size() / 2]);
  for (std::size_t b = 0; b < used.size(); ++b)
    if (used[b] && out.boards[b].rms_px > largest) used[b] = false;
}

Result<void> check_focal(const LensFit& fit) {
  const double worst = std::max(fit.sigma(0) / fit.intrinsics[0], fit.sigma(1) / fit.intrinsics[1]);
  constexpr double kMaxSigma = .02;
  if (worst > kMaxSigma)
    return lens_undetermined(fmt::format(
        "the focal length is uncertain by {:.1f} %: add pictures of the board tilted by "
        "30 to 45 degrees, to each side",
        100 * worst));
  return {};
}

// Towards the axis xi and alpha do the same to the picture.
Result<void> check_double_sphere(const LensFit& fit) {
  constexpr double kMaxSigma = .05;
  if (fit.sigma(kShared) <= kMaxSigma) return {};
  return lens_undetermined(
      fmt::format("xi is uncertain by {:.2f}, since xi and alpha can only be told apart far from "
                  "the axis: bring the board to the borders, or calibrate as kb4",
                  fit.sigma(kShared)));
}

Result<void> check_reach(const CameraCalibration& c, bool distorted) {
  constexpr double kMinReach = .4;
  if (distorted && c.reach < kMinReach)
    return lens_undetermined(
        fmt::format("no corner of the board lies beyond {:.0f} % of the way to the picture's "
                    "corners, so the lens stays unknown there: bring the board to the borders",
                    100 * c.reach));
  return {};
}

// From the solver's focal length f' = f / (1 + xi) to the paper's f, with its covariance.
void of_paper(LensFit& fit) {
  const std::size_t n = fit.intrinsics.size();
  const double stretch = 1 + fit.intrinsics[kShared];
  std::vector<double> jacobian(n * n, 0), half(n * n, 0), whole(n * n, 0);
  for (std::size_t i = 0; i < n; ++i) jacobian[i * n + i] = i < 2 ? stretch : 1;
  for (std::size_t i = 0; i < 2; ++i) jacobian[i * n + kShared] = fit.intrinsics[i];
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      for (std::size_t k = 0; k < n; ++k)
        half[i * n + j] += jacobian[i * n + k] * fit.covariance[k * n + j];
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      for (std::size_t k = 0; k < n; ++k) whole[i * n + j] += half[i * n + k] * jacobian[j * n + k];
  fit.covariance = std::move(whole);
  for (std::size_t i = 0; i < 2; ++i) fit.intrinsics[i] *= stretch;
}

template <class Lens>
Result<CameraCalibration> fit_lens(std::span<const BoardView> views, const CameraModel& start,
                                   LensGuess guess, std::span<const int> fixed) {
  const int free_terms = Lens::kDistortion - static_cast<int>(fixed.size());
  LensFit fit{{guess.focal, guess.focal, start.principal_px.x, start.principal_px.y},
              std::move(guess.poses),
              {}};
  fit.intrinsics.resize(kShared + Lens::kDistortion, 0);
  if (std::is_same_v<
          Lens,
          DoubleSphere>) {  // of usual lenses; at xi = 0 the slope over xi and alpha is the same
    fit.intrinsics[kShared] = -.2;
    fit.intrinsics[kShared + 1] = .6;
  }
  std::vector<bool> used;
  for (const auto& pose : fit.poses) used.push_back(pose.has_value());
  Solver<Lens> solver(views, fit, fixed);
  CameraCalibration out;
  out.boards.resize(views.size());
  for (std::size_t b = 0; b < views.size(); ++b) out.boards[b].name = views[b].name;
  std::vector<glm::dvec2> all;
  const auto measure = [&] {
    all.clear();
    for (std::size_t b = 0; b < views.size(); ++b) {
      BoardFit& board = out.boards[b];
      board.used = used[b];
      if (!fit.poses[b]) continue;
      board.residuals_px = solver.residuals(b);
      board.rms_px = rms(board.residuals_px);
      if (used[b]) all.insert(all.end(), board.residuals_px.begin(), board.residuals_px.end());
    }
    out.rms_px = rms(all);
  };
  for (int pass = 0; pass < 3; ++pass) {
    if (static_cast<std::size_t>(std::ranges::count(used, true)) < kMinBoards)
      return lens_undetermined(
          "fewer than 3 pictures of the board agree with each other: keep the board flat and "
          "still");
    if (!solver.solve(1, used))
      return lens_undetermined("the least-squares solution does not converge");
    measure();
    if (pass < 2) leave_out(out, used);
  }
  measure();
  const double parameters =
      kShared + free_terms + 6. * static_cast<double>(std::ranges::count(used, true));
  const double freedom = 2. * static_cast<double>(all.size()) - parameters;
  const double variance = out.rms_px * out.rms_px * static_cast<double>(all.size()) / freedom;
  if (!solver.estimate_covariance(variance, used))
    return lens_undetermined(
        "the pictures do not determine the camera: add pictures of the board tilted by 30 to 45 "
        "degrees");
  PENUMBRA_TRY(check_focal(fit));
  if (std::is_same_v<Lens, DoubleSphere>) {
    PENUMBRA_TRY(check_double_sphere(fit));
    of_paper(fit);
  }
  out.projection = start;
  for (int i = 0; i < 2; ++i) {
    const auto n = static_cast<std::size_t>(i);
    out.projection.focal_px[i] = fit.intrinsics[n];
    out.projection.principal_px[i] = fit.intrinsics[2 + n];
    out.focal_sigma_px[i] = fit.sigma(n);
    out.principal_sigma_px[i] = fit.sigma(2 + n);
  }
  for (std::size_t i = 0; i < Lens::kDistortion; ++i) {
    out.projection.distortion[i] = fit.intrinsics[kShared + i];
    out.distortion_sigma[i] = fit.sigma(kShared + i);
  }
  out.covariance = fit.covariance;
  for (std::size_t b = 0; b < views.size(); ++b)
    if (fit.poses[b]) out.boards[b].camera_from_board = in_our_axes(*fit.poses[b]);
  measure_spread(views, out);
  PENUMBRA_TRY(check_reach(out, free_terms > 0));
  for (const int term : fixed) out.distortion_fixed[static_cast<std::size_t>(term)] = true;
  return out;
}

// Which terms of the distortion are held at 0, one list after the other until the rest makes a
// lens: pictures that end at 20 degrees do not determine what the highest terms do at 30.
template <class Lens>
std::vector<std::vector<int>> held_terms() {
  if (std::is_same_v<Lens, Pinhole>) return {{}, {4}, {1, 4}, {1, 2, 3, 4}};
  if (std::is_same_v<Lens, KannalaBrandt>) return {{}, {3}, {2, 3}, {1, 2, 3}};
  return {{}};
}

template <class Lens>
Result<CameraCalibration> calibrate(std::span<const BoardView> views, const CameraModel& start) {
  const LensGuess guess = best_guess(views, start.kind, start.width, start.height);
  if (!std::isfinite(guess.cost))
    return lens_undetermined("no pose of the board fits this projection: is --projection right?");
  constexpr double kAsGood = 1.1;  // RMS against that of all terms
  std::optional<Error> first;
  double rms_of_all = 0;
  for (const std::vector<int>& fixed : held_terms<Lens>()) {
    auto out = fit_lens<Lens>(views, start, guess, fixed);
    // Fewer terms make up for no picture that is missing.
    if (!out) return first ? std::unexpected(*first) : std::unexpected(out.error());
    if (first && out->rms_px > kAsGood * rms_of_all) break;
    auto valid = with_distortion(
        out->projection, std::span(out->projection.distortion)
                             .first(static_cast<std::size_t>(distortion_count(start.kind))));
    if (valid) {
      out->projection = std::move(*valid);
      return out;
    }
    if (!first) first = valid.error(), rms_of_all = out->rms_px;
  }
  return std::unexpected(*first);
}

}  // namespace

Result<CameraCalibration> calibrate_camera(std::span<const BoardView> views, ProjectionKind kind,
                                           int width, int height) {
  if (!has_intrinsics(kind))
    return fail(ErrorCode::kInvalid, std::string(projection_name(kind)),
                "has no intrinsics to calibrate; pinhole, equidistant, kb4 and double-sphere have");
  PENUMBRA_ASSIGN(start, make_projection(kind, width, height));
  if (views.size() < kMinBoards)
    return lens_undetermined(
        fmt::format("the board was found in {} pictures, and at least {} are needed: take ten to "
                    "thirty, from different sides and up to the borders",
                    views.size(), kMinBoards));
  switch (kind) {
    case ProjectionKind::kEquidistant:
      return calibrate<Equidistant>(views, start);
    case ProjectionKind::kKannalaBrandt:
      return calibrate<KannalaBrandt>(views, start);
    case ProjectionKind::kDoubleSphere:
      return calibrate<DoubleSphere>(views, start);
    default:
      return calibrate<Pinhole>(views, start);
  }
}

}  // namespace penumbra::calib
