#include <algorithm>
#include <cmath>
#include <vector>

#include "capture/watch/white_balance_watch.h"
#include "core/median.h"

namespace penumbra::capture {

namespace {

constexpr int kMinBalanceFrames = 4;   // in the mean
constexpr std::size_t kEvery = 3;      // of the cells
constexpr std::size_t kMinCells = 40;  // that tell
constexpr float kDark = .02f;          // of full scale: below, noise moves colours
constexpr double kShift = .03;         // 3 %: less is drift of lamps and of the sensor
constexpr double kUniform = .2;        // of the shift: the cells' median distance from it
constexpr double kStill = .5;          // of the shift: green changes by less
constexpr int kLasting = 3;            // frames

struct Spread {
  double middle, distance;  // median, and the median distance from it
};
// Spends the values.
Spread spread_of(std::vector<double>& values) {
  Spread out{median(values), 0};
  for (double& v : values) v = std::abs(v - out.middle);
  out.distance = median(values);
  return out;
}

}  // namespace

std::optional<WhiteBalanceWatch::Shift> WhiteBalanceWatch::see(
    const PictureHistory::Comparison& compared) {
  if (compared.frames < kMinBalanceFrames) return std::nullopt;
  red_.clear(), green_.clear(), blue_.clear();
  for (std::size_t i = 0; i < compared.now.size(); i += kEvery) {
    const Rgb &usual = compared.usual[i], &now = compared.now[i];
    const bool tells = std::min({usual.r, usual.g, usual.b}) > kDark &&
                       std::min({now.r, now.g, now.b}) > kDark;  // NaN does not
    if (!tells) continue;
    const double green = std::log(now.g / usual.g);
    red_.push_back(std::log(now.r / usual.r) - green);
    green_.push_back(green);
    blue_.push_back(std::log(now.b / usual.b) - green);
  }
  if (green_.size() < kMinCells) return std::nullopt;
  const Spread r = spread_of(red_), g = spread_of(green_), b = spread_of(blue_);
  const double shift = std::max(std::abs(r.middle), std::abs(b.middle));
  const bool moved = shift > kShift && std::max(r.distance, b.distance) < kUniform * shift &&
                     std::abs(g.middle) < kStill * shift;
  shifted_ = moved ? shifted_ + 1 : 0;
  if (shifted_ < kLasting) return std::nullopt;
  return Shift{r.middle, b.middle};
}

}  // namespace penumbra::capture
