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

// On a logarithmic scale, upwards to what misses the goal: excess(good) <= 0 < excess(bad), where
// they are known.
struct GoalBracket {
  double good, bad;
  std::optional<double> good_excess, bad_excess;
  double slope = 1;  // of the excess, by the last two tries: 1 where errors are proportional
};

// The line through both sides, at times their middle. With one side alone a step by the slope, and
// after some that end of the range: errors have floors.
inline double next_try(const GoalBracket& b, int tries) {
  constexpr double kBelow = .01;  // aimed at, of the goal
  constexpr int kStraight = 3;
  constexpr double kBeyond = 1.1;  // so that the other side is known, too
  const double width = b.bad - b.good, margin = .02 * width;
  if (b.good_excess && b.bad_excess) {
    const double line =
        b.good + width * (-kBelow - *b.good_excess) / (*b.bad_excess - *b.good_excess);
    const bool middle = tries > kStraight && tries % 3 == 2;
    return std::clamp(middle ? b.good + width / 2 : line, b.good + margin, b.bad - margin);
  }
  const double end = b.good_excess ? b.bad : b.good;
  if (tries >= kStraight) return end;
  const double from = b.good_excess ? b.good : b.bad,
               excess = b.good_excess ? *b.good_excess : *b.bad_excess;
  const double step = kBeyond * (std::abs(excess) + kBelow) / b.slope;
  return end > from ? std::min(from + step, end) : std::max(from - step, end);
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
  constexpr double kNear = .02, kFlat = .1;
  double good = by_size ? -std::log(high) : std::log(low),
         bad = by_size ? -std::log(low) : std::log(high);
  std::optional<double> good_excess, bad_excess;
  std::optional<CodedStill> best;
  CodedStill nearest;  // where none is within the goal
  double slope = 1;
  double at = by_size ? -std::log(first) : std::log(first);
  for (int i = 0; i < kTries; ++i) {
    PENUMBRA_ASSIGN(coded, encode(std::exp(by_size ? -at : at)));
    const double excess = by_size
                              ? std::log(double(coded.bytes.size()) / double(goal.max_bytes))
                              : std::log(std::max(coded.error.larger(), 1e-12) / goal.deviation);
    if (const auto known = good_excess ? good_excess : bad_excess;
        known && !(good_excess && bad_excess))
      slope = std::clamp((excess - *known) / (at - (good_excess ? good : bad)), kFlat, 1 / kFlat);
    if (excess <= 0) {
      best = std::move(coded);
      good = at, good_excess = excess;
      if (excess > -kNear) break;
    } else {
      if (!bad_excess || excess < *bad_excess) nearest = std::move(coded);
      bad = at, bad_excess = excess;
    }
    if (bad - good < 1e-3) break;
    at = next_try({good, bad, good_excess, bad_excess, slope}, i);
  }
  if (best) return std::move(*best);
  return fail(ErrorCode::kUndetermined, "goal",
              by_size ? fmt::format("cannot be met: the picture takes {} bytes at least",
                                    nearest.bytes.size())
                      : fmt::format("cannot be met: the best that this coder reaches is off by "
                                    "{:.4g} %",
                                    100 * (std::pow(10, nearest.error.larger()) - 1)));
}

}  // namespace penumbra::codec
