#include "calib/track/pose_filter.h"

#include <algorithm>
#include <glm/geometric.hpp>

#include "calib/track/internal/matrix6.h"
#include "calib/track/internal/small_turns.h"

namespace penumbra::calib {

namespace {

constexpr Seconds kForgets{.5};
// Spectral densities of the acceleration, rad^2/s^3, in steps of ten: from a tripod to a jerk.
constexpr double kStill = 1e-7, kLevelStep = 10;
constexpr int kLevels = 10;
constexpr int kMoving = 4;     // from here on a picture counts more than the motion before
constexpr double kArm_m = .4;  // metres that a radian moves a camera by
// Of six degrees of freedom: exceeded once in a hundred, once in a million pictures.
constexpr double kUsual = 16.8, kJump = 38;
constexpr double kCalm = 8;  // below it a lower level is tried; half of the pictures at rest have 5
constexpr double kKept = .7;  // of the mean innovation, from picture to picture
constexpr double kVelocity_rad = 4, kVelocity_m = 2;  // at the first picture, one sigma

Vector6 difference(const Pose& from, const Pose& to) {
  const glm::dvec3 w = turn_of(to.rotation * glm::conjugate(from.rotation)),
                   d = to.translation - from.translation;
  return {w.x, w.y, w.z, d.x, d.y, d.z};
}

Pose moved(const Pose& pose, const Vector6& by) {
  return {glm::normalize(rotation_by({by[0], by[1], by[2]}) * pose.rotation),
          pose.translation + glm::dvec3(by[3], by[4], by[5])};
}

double distance2(const Matrix6& factor, const Vector6& v) {
  return dot(v, solve_by(factor, v));
}

}  // namespace

struct PoseFilter::State {
  TimestampNs time;
  Pose pose;
  Vector6 velocity{};                     // about and along the world's axes, a second
  Matrix6 of_pose, of_both, of_velocity;  // covariance
  Vector6 mean{};                         // of the innovations
  int level = 0;                          // of the acceleration
  bool doubted = false;

  void begin(const TrackedPose& m) {
    *this = {};
    time = m.time;
    pose = m.world_from_camera;
    of_pose.m = m.covariance;
    of_velocity = Matrix6::diagonal(kVelocity_rad * kVelocity_rad, kVelocity_m * kVelocity_m);
  }

  void predict(double dt) {
    Vector6 step = velocity;
    for (double& v : step) v *= dt;
    pose = moved(pose, step);
    of_pose = of_pose + dt * (of_both + of_both.transposed()) + dt * dt * of_velocity;
    of_both = of_both + dt * of_velocity;
  }

  // What an acceleration of that level adds to the covariance.
  static Matrix6 density(int wanted) {
    double q = kStill;
    for (int i = 0; i < wanted; ++i) q *= kLevelStep;
    return Matrix6::diagonal(q, q * kArm_m * kArm_m);
  }
  Matrix6 innovation(int wanted, double dt, const Matrix6& noise) const {
    return of_pose + dt * dt * dt / 3 * density(wanted) + noise;
  }

  // The lowest level that explains the innovation and its mean, not much below the last; nothing
  // where none does.
  bool choose_level(double dt, const Matrix6& noise, const Vector6& off) {
    Vector6 trend = mean;
    for (std::size_t i = 0; i < 6; ++i) trend[i] = kKept * trend[i] + (1 - kKept) * off[i];
    const double of_mean = (1 - kKept) / (1 + kKept);  // its variance over that of one
    for (int next = std::max(0, level - 1); next < kLevels; ++next) {
      const auto factor = cholesky(innovation(next, dt, noise));
      if (!factor) return false;
      const bool top = next == kLevels - 1;
      const double most = top ? kJump : next < level || level >= kMoving ? kCalm : kUsual;
      if (distance2(*factor, off) > most || (!top && distance2(*factor, trend) > of_mean * most))
        continue;
      level = next;
      mean = trend;
      return true;
    }
    return false;
  }

  void correct(double dt, const Matrix6& noise, const Vector6& off) {
    const Matrix6 q = density(level);
    of_pose = of_pose + dt * dt * dt / 3 * q;
    of_both = of_both + dt * dt / 2 * q;
    of_velocity = of_velocity + dt * q;
    const auto inverse = inverse_of(of_pose + noise);
    if (!inverse) return;
    const Matrix6 gain = of_pose * *inverse, velocity_gain = of_both.transposed() * *inverse;
    pose = moved(pose, gain * off);
    const Vector6 change = velocity_gain * off;
    for (std::size_t i = 0; i < 6; ++i) velocity[i] += change[i];
    of_velocity = of_velocity - velocity_gain * of_both;
    of_both = of_both - gain * of_both;
    of_pose = of_pose - gain * of_pose;
    of_pose = .5 * (of_pose + of_pose.transposed());
    of_velocity = .5 * (of_velocity + of_velocity.transposed());
  }
};

PoseFilter::PoseFilter() = default;
PoseFilter::PoseFilter(PoseFilter&&) noexcept = default;
PoseFilter& PoseFilter::operator=(PoseFilter&&) noexcept = default;
PoseFilter::~PoseFilter() = default;

TrackedPose PoseFilter::update(const TrackedPose& measured) {
  if (!state_) {
    state_ = std::make_unique<State>();
    state_->begin(measured);
    return measured;
  }
  State& s = *state_;
  const double dt = (measured.time - s.time).count();
  if (!(dt > 0) || dt > kForgets.count()) {
    s.begin(measured);
    return measured;
  }
  s.predict(dt);
  s.time = measured.time;
  const Vector6 off = difference(s.pose, measured.world_from_camera);
  const Matrix6 noise{measured.covariance};
  TrackedPose out = measured;
  if (!s.choose_level(dt, noise, off)) {
    if (s.doubted) {
      s.begin(measured);
      return measured;
    }
    s.doubted = true;
    s.level = kLevels - 1;
    s.of_pose = s.of_pose + dt * dt * dt / 3 * State::density(s.level);
  } else {
    s.doubted = false;
    s.correct(dt, noise, off);
  }
  out.world_from_camera = s.pose;
  out.covariance = s.of_pose.m;
  return out;
}

}  // namespace penumbra::calib
