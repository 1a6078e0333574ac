// How late a camera's frames are against the poses of a tracker that it is fixed to, from turning
// both together. How they are fixed to each other need not be known: a turn has the same angle in
// every frame.
// source: angles of a hand-eye pair are equal, Tsai & Lenz 1989; time offset, Furgale et al. 2013
// threads: reentrant
#pragma once

#include <glm/gtc/quaternion.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// How something is turned, against anything that stands still.
struct TurnSample {
  double time_s = 0;
  glm::dquat turn{1, 0, 0, 0};  // unit
};

struct LatencyOptions {
  double max_offset_s = .5;  // of the tracker's clock, above 0
};

/// By how much both turned within a short time.
struct TurnStep {
  double middle_s;                 // the camera's time
  double camera_rad, tracker_rad;  // the latter at the offset that was found
  double seconds;                  // how long it took
};

struct Latency {
  double offset_s = 0;  // a frame of camera time t was taken at t + offset of the tracker's
  double sigma_s = 0;   // one standard deviation
  // By how much the second half's offset exceeds the first's: clocks that run apart. Nothing where
  // one of them hardly turns.
  std::optional<double> drift_s{};
  double drift_sigma_s = 0;
  double residual_rad = 0;  // of the steps' angles: 1.48 medians, a standard deviation
  std::vector<TurnStep> steps;
};

/// in:  samples by time
/// errors: kInvalid (times out of order, a maximum that is not above 0), kNonFinite, kUndetermined
///         (too few steps, too little or too even a turn, one that repeats itself, an offset at the
///         maximum, two that do not turn alike)
Result<Latency> estimate_latency(std::span<const TurnSample> camera,
                                 std::span<const TurnSample> tracker,
                                 const LatencyOptions& options = {});

}  // namespace penumbra::calib
#pragma GCC visibility pop
