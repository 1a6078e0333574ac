#include "calib/estimate/latency.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

#include "core/conventions.h"

namespace penumbra::calib {

namespace {

constexpr double kOneDegree = kPi / 180;
constexpr double kStep_s = .1, kLongestStep_s = .25;
constexpr double kLongestGap_s = .1;     // of the tracker
constexpr double kGrid_s = .002;         // of the offsets that are tried
constexpr double kOutlier = kOneDegree;  // residuals beyond count by their size, not its square
constexpr double kMinTurn = kOneDegree;  // standard deviation of the steps' angles
constexpr double kMaxResidual = .3;      // of that, of what is left
constexpr std::size_t kFewestSteps = 20;
constexpr const char* kWhere = "latency";
constexpr const char* kSilent =
    "the tracker has poses for too few of the times at which the board is seen: do both clocks "
    "count "
    "from the same moment?";

double turned_by(const glm::dquat& a, const glm::dquat& b) {
  const glm::dquat d = glm::conjugate(a) * b;
  return 2 * std::atan2(glm::length(glm::dvec3(d.x, d.y, d.z)), std::abs(d.w));
}

std::optional<glm::dquat> turn_at(std::span<const TurnSample> samples, double time_s) {
  const auto next = std::ranges::lower_bound(samples, time_s, {}, &TurnSample::time_s);
  if (next == samples.begin() || next == samples.end()) return std::nullopt;
  const TurnSample& before = *std::prev(next);
  const double gap = next->time_s - before.time_s;
  if (gap > kLongestGap_s) return std::nullopt;
  return glm::slerp(before.turn, next->turn, (time_s - before.time_s) / gap);
}

// From one frame to another.
struct CameraStep {
  double from_s, to_s, angle_rad;
};

std::vector<CameraStep> steps_of(std::span<const TurnSample> camera) {
  std::vector<CameraStep> out;
  std::size_t j = 0;
  for (std::size_t i = 0; i < camera.size(); ++i) {
    while (j < camera.size() && camera[j].time_s - camera[i].time_s < kStep_s) ++j;
    if (j == camera.size()) break;
    if (camera[j].time_s - camera[i].time_s <= kLongestStep_s)
      out.push_back(
          {camera[i].time_s, camera[j].time_s, turned_by(camera[i].turn, camera[j].turn)});
  }
  return out;
}

// The steps at one offset of the tracker's clock.
class StepFit {
 public:
  StepFit(std::span<const CameraStep> steps, std::span<const TurnSample> tracker)
      : steps_(steps), tracker_(tracker) {}

  std::optional<double> tracker_angle(const CameraStep& step, double offset_s) const {
    const auto from = turn_at(tracker_, step.from_s + offset_s),
               to = turn_at(tracker_, step.to_s + offset_s);
    if (!from || !to) return std::nullopt;
    return turned_by(*from, *to);
  }

  // Mean of a loss that wrong boards add the same to at every offset; nothing where the tracker is
  // silent for a fifth of the steps.
  std::optional<double> cost(double offset_s) const {
    double sum = 0;
    std::size_t known = 0;
    for (const CameraStep& step : steps_)
      if (const auto angle = tracker_angle(step, offset_s)) {
        const double r = std::min(std::abs(step.angle_rad - *angle), kOutlier);
        sum += r * r / 2;
        ++known;
      }
    if (5 * known < 4 * steps_.size() || known < kFewestSteps) return std::nullopt;
    return sum / static_cast<double>(known);
  }

  struct Estimate {
    double offset_s, sigma_s;
  };
  // Gauss-Newton from nearby. What neighbouring steps have in common counts in its uncertainty.
  // source: Newey & West 1987
  Estimate refine(double offset_s) const {
    constexpr int kRounds = 10;
    for (int round = 0; round < kRounds; ++round) {
      const auto [scores, curvature] = linearised(offset_s);
      if (curvature <= 0) break;
      const double sum = std::accumulate(scores.begin(), scores.end(), 0.);
      offset_s += std::clamp(sum / curvature, -kGrid_s, kGrid_s);
    }
    const auto [scores, curvature] = linearised(offset_s);
    const int lag = overlap();
    double variance = 0;
    for (std::size_t i = 0; i < scores.size(); ++i)
      for (int k = -lag; k <= lag; ++k) {
        const auto j = static_cast<std::ptrdiff_t>(i) + k;
        if (j < 0 || j >= std::ssize(scores)) continue;
        variance +=
            (1 - std::abs(k) / (lag + 1.)) * scores[i] * scores[static_cast<std::size_t>(j)];
      }
    return {offset_s, curvature > 0 ? std::sqrt(std::max(0., variance)) / curvature : 0};
  }

 private:
  struct Linearised {
    std::vector<double> scores;  // slope times residual, by step
    double curvature = 0;
  };
  Linearised linearised(double offset_s) const {
    Linearised out;
    for (const CameraStep& step : steps_) {
      const auto here = tracker_angle(step, offset_s),
                 before = tracker_angle(step, offset_s - kGrid_s),
                 after = tracker_angle(step, offset_s + kGrid_s);
      if (!here || !before || !after) continue;
      const double slope = (*after - *before) / (2 * kGrid_s), r = step.angle_rad - *here,
                   weight = std::min(1., kOutlier / std::max(std::abs(r), 1e-12));
      out.scores.push_back(weight * slope * r);
      out.curvature += weight * slope * slope;
    }
    return out;
  }
  // How many of the steps after one begin before it ends.
  int overlap() const {
    int most = 1;
    for (std::size_t i = 0, j = 0; i < steps_.size(); ++i) {
      while (j < steps_.size() && steps_[j].from_s <= steps_[i].to_s) ++j;
      most = std::max(most, static_cast<int>(j - i));
    }
    return most;
  }

  std::span<const CameraStep> steps_;
  std::span<const TurnSample> tracker_;
};

Result<void> check(std::span<const TurnSample> samples, const char* whose) {
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const TurnSample& s = samples[i];
    if (!std::isfinite(s.time_s) || !std::isfinite(s.turn.w + s.turn.x + s.turn.y + s.turn.z))
      return fail(ErrorCode::kNonFinite, whose, fmt::format("has a pose {} that is no number", i));
    if (i > 0 && !(s.time_s > samples[i - 1].time_s))
      return fail(ErrorCode::kInvalid, whose, fmt::format("has a pose {} out of order", i));
  }
  return {};
}

// Of all offsets the one that fits best, if no other fits about as well.
Result<double> best_on_grid(const StepFit& fit, double max_offset_s) {
  const int half = static_cast<int>(std::ceil(max_offset_s / kGrid_s));
  std::vector<std::optional<double>> costs;
  for (int i = -half; i <= half; ++i) costs.push_back(fit.cost(i * kGrid_s));
  const auto value = [&](std::size_t i) { return costs[i].value_or(1e9); };
  std::size_t best = 0;
  for (std::size_t i = 0; i < costs.size(); ++i)
    if (value(i) < value(best)) best = i;
  if (!costs[best]) return fail(ErrorCode::kUndetermined, kWhere, kSilent);
  const auto offset = [&](std::size_t i) { return (static_cast<int>(i) - half) * kGrid_s; };
  if (best == 0 || best + 1 == costs.size() || !costs[best - 1] || !costs[best + 1])
    return fail(ErrorCode::kUndetermined, kWhere,
                fmt::format("the clocks are more than {:.0f} ms apart, or the tracker's poses end "
                            "before the pictures: see --max-offset",
                            1000 * std::abs(offset(best))));
  // As good as noise of a twentieth of a degree makes them.
  constexpr double kAlike = 3, kNoise = .5 * (.05 * kOneDegree) * (.05 * kOneDegree);
  for (std::size_t i = 1; i + 1 < costs.size(); ++i)
    if (std::abs(offset(i) - offset(best)) > kStep_s && value(i) <= value(i - 1) &&
        value(i) <= value(i + 1) && value(i) < kAlike * value(best) + kNoise)
      return fail(ErrorCode::kUndetermined, kWhere,
                  fmt::format("offsets of {:.0f} and {:.0f} ms fit alike: the motion repeats "
                              "itself; turn the rig irregularly",
                              1000 * offset(best), 1000 * offset(i)));
  return offset(best);
}

// The tracker may have run for hours.
std::span<const TurnSample> during(std::span<const TurnSample> samples, double from_s,
                                   double to_s) {
  const auto first = std::ranges::lower_bound(samples, from_s, {}, &TurnSample::time_s),
             last = std::ranges::upper_bound(samples, to_s, {}, &TurnSample::time_s);
  return {first, last};
}

double deviation(std::span<const CameraStep> steps) {
  if (steps.empty()) return 0;
  double sum = 0, squares = 0;
  for (const CameraStep& s : steps) sum += s.angle_rad, squares += s.angle_rad * s.angle_rad;
  const auto n = static_cast<double>(steps.size());
  return std::sqrt(std::max(0., squares / n - sum / n * (sum / n)));
}

}  // namespace

Result<Latency> estimate_latency(std::span<const TurnSample> camera,
                                 std::span<const TurnSample> all_of_tracker,
                                 const LatencyOptions& options) {
  PENUMBRA_TRY(check(camera, "camera"));
  PENUMBRA_TRY(check(all_of_tracker, "tracker"));
  if (!(options.max_offset_s > 0 && options.max_offset_s <= 10))
    return fail(ErrorCode::kInvalid, kWhere, "the largest offset is not within 0..10 s");
  const std::vector<CameraStep> steps = steps_of(camera);
  if (steps.size() < kFewestSteps)
    return fail(ErrorCode::kUndetermined, kWhere,
                fmt::format("the board is seen in {} pairs of pictures {:.0f} to {:.0f} ms apart, "
                            "{} are needed",
                            steps.size(), 1000 * kStep_s, 1000 * kLongestStep_s, kFewestSteps));
  const double turned = deviation(steps);
  if (turned < kMinTurn)
    return fail(ErrorCode::kUndetermined, kWhere,
                fmt::format("the rig turns by {:.1f} degrees more or less within {:.0f} ms: turn "
                            "it to and fro faster, by 20 degrees or more",
                            turned / kOneDegree, 1000 * kStep_s));
  const auto tracker =
      during(all_of_tracker, steps.front().from_s - options.max_offset_s - kLongestGap_s,
             steps.back().to_s + options.max_offset_s + kLongestGap_s);
  const std::vector<CameraStep> of_tracker = steps_of(tracker);
  if (of_tracker.size() < kFewestSteps) return fail(ErrorCode::kUndetermined, kWhere, kSilent);
  if (const double by_tracker = deviation(of_tracker); by_tracker < kMinTurn)
    return fail(ErrorCode::kUndetermined, kWhere,
                fmt::format("the tracker turns by {:.1f} degrees more or less within {:.0f} ms and "
                            "the camera by {:.1f}: is one fixed to the other?",
                            by_tracker / kOneDegree, 1000 * kStep_s, turned / kOneDegree));
  const StepFit fit(steps, tracker);
  PENUMBRA_ASSIGN(nearby_s, best_on_grid(fit, options.max_offset_s));
  const auto [offset_s, sigma_s] = fit.refine(nearby_s);
  Latency out;
  out.offset_s = offset_s;
  out.sigma_s = sigma_s;
  std::vector<double> residuals;
  for (const CameraStep& s : steps)
    if (const auto angle = fit.tracker_angle(s, offset_s)) {
      out.steps.push_back({(s.from_s + s.to_s) / 2, s.angle_rad, *angle, s.to_s - s.from_s});
      residuals.push_back(std::abs(s.angle_rad - *angle));
    }
  const auto middle = residuals.begin() + std::ssize(residuals) / 2;
  std::ranges::nth_element(residuals, middle);
  out.residual_rad = 1.4826 * *middle;
  if (out.residual_rad > kMaxResidual * turned)
    return fail(ErrorCode::kUndetermined, kWhere,
                fmt::format("camera and tracker do not turn alike: {:.2f} of {:.2f} degrees are "
                            "left; is the tracker fixed to the camera, and does the board stand "
                            "still?",
                            out.residual_rad / kOneDegree, turned / kOneDegree));
  const std::span<const CameraStep> all(steps);
  const auto earlier = all.first(all.size() / 2), later = all.subspan(all.size() / 2);
  // By the tracker, which has no boards that are wrong.
  const auto turns = [&](std::span<const CameraStep> part) {
    std::vector<CameraStep> seen;
    for (const CameraStep& s : part)
      if (const auto angle = fit.tracker_angle(s, offset_s)) seen.push_back({0, 0, *angle});
    return deviation(seen) >= kMinTurn;
  };
  if (turns(earlier) && turns(later)) {
    const auto first = StepFit(earlier, tracker).refine(offset_s),
               second = StepFit(later, tracker).refine(offset_s);
    out.drift_s = second.offset_s - first.offset_s;
    out.drift_sigma_s = std::hypot(first.sigma_s, second.sigma_s);
  }
  return out;
}

}  // namespace penumbra::calib
