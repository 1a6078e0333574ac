// Finds how coarse a coder may be; not for other folders.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "codec/still_goal.h"
#include "core/result.h"

namespace penumbra::codec {

inline Result<void> check_goal(const StillGoal& goal) {
  if (goal.deviation >= 1e-5 && goal.deviation <= 1) return {};
  return fail(ErrorCode::kInvalid, "goal", "has a deviation that is not within 0.00001..1");
}

/// `encode(coarseness)` with the best coarseness within low..high: the largest whose error is
/// within the goal, or the smallest whose bytes are. Takes errors and bytes as powers of coarseness
/// and stops within 2 % of the goal.
/// errors: kUndetermined (not even the finest, or the coarsest, is within it); those of encode
template <class Encode>
Result<CodedStill> search_goal(const StillGoal& goal, double low, double high, double first,
                               Encode&& encode) {
  const bool by_size = goal.max_bytes > 0;
  constexpr int kTries = 12;
  constexpr double kNear = .02;
  // On a logarithmic scale, upwards to what misses the goal: excess(good) <= 0 < excess(bad).
  double good = by_size ? -std::log(high) : std::log(low),
         bad = by_size ? -std::log(low) : std::log(high);
  std::optional<double> good_excess, bad_excess;
  std::optional<CodedStill> best;
  CodedStill nearest;  // where none is within the goal
  double at = by_size ? -std::log(first) : std::log(first);
  for (int i = 0; i < kTries; ++i) {
    PENUMBRA_ASSIGN(coded, encode(std::exp(by_size ? -at : at)));
    const double excess = by_size ? std::log(double(coded.bytes.size()) / double(goal.max_bytes))
                                  : std::log(std::max(coded.deviation, 1e-12) / goal.deviation);
    if (excess <= 0) {
      best = std::move(coded);
      good = at, good_excess = excess;
      if (excess > -kNear) break;
    } else {
      if (!bad_excess || excess < *bad_excess) nearest = std::move(coded);
      bad = at, bad_excess = excess;
    }
    if (bad - good < 1e-3) break;
    // The line through both sides, kept off them; one side alone: a step as if the excess were
    // proportional, and halves where that leaves the range.
    double next = (good + bad) / 2;
    if (good_excess && bad_excess && i % 3 != 2)
      next = good + (bad - good) * (-kNear / 2 - *good_excess) / (*bad_excess - *good_excess);
    else if (!good_excess || !bad_excess)
      next = at - excess * 1.2 - kNear / 2;
    const double margin = (bad - good) * .02;
    at = std::clamp(next, good_excess ? good + margin : good, bad_excess ? bad - margin : bad);
    if (at == (excess <= 0 ? good : bad)) break;  // at the end of the range
  }
  if (best) return std::move(*best);
  return fail(ErrorCode::kUndetermined, "goal",
              by_size ? fmt::format("cannot be met: the picture takes {} bytes at least",
                                    nearest.bytes.size())
                      : fmt::format("cannot be met: the best that this coder reaches is off by "
                                    "{:.3g} %",
                                    100 * (std::pow(10, nearest.deviation) - 1)));
}

}  // namespace penumbra::codec
