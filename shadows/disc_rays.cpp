#include "shadows/disc_rays.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/gtx/quaternion.hpp>

#include "core/conventions.h"

namespace penumbra::shadows {

double largest_angle(const lighting::Disc& disc) {
  double largest = disc.shape.empty() ? disc.radius.value() : 0;
  for (const glm::dvec3& d : disc.shape)
    largest = std::max(largest, std::acos(std::clamp(glm::dot(d, disc.direction), -1., 1.)));
  return largest;
}

Beam beam_of(const lighting::Disc& disc, double more) {
  return {disc.direction, std::sin(std::min(largest_angle(disc) + more, kPi / 2))};
}

OutlineMemo& memo_of(const Casters& casters) {
  if (casters.memo) return *casters.memo;
  thread_local OutlineMemo empty;
  empty.clear();
  return empty;
}

void TapPattern::make(const lighting::Disc& disc, int taps, int turns) {
  assert(taps >= 1 && taps <= kMostTaps && turns >= 1);
  taps_ = taps, turns_ = turns;
  directions_.clear();
  if (taps == 1 && turns == 1)
    directions_.emplace_back(disc.direction);
  else if (disc.shape.empty())
    spread_over_cap(disc);
  else
    spread_over_shape(disc);
}

// A Vogel spiral from the rim inwards, which has as many points in equal areas.
void TapPattern::spread_over_cap(const lighting::Disc& disc) {
  const glm::dmat3 frame = glm::mat3_cast(glm::rotation(glm::dvec3(0, 1, 0), disc.direction));
  const double height = 2 * std::pow(std::sin(.5 * disc.radius.value()), 2);
  for (int turn = 0; turn < turns_; ++turn)
    for (int k = taps_ - 1; k >= 0; --k) {
      const double c = 1 - height * (k + .5) / taps_, s = std::sqrt(1 - c * c);
      // The turns follow the golden ratio, so that neighbours differ most.
      constexpr double kGolden = 2.399963229728653;
      const double a = k * kGolden + 2 * kPi * std::fmod(turn * .6180339887498949, 1.);
      directions_.emplace_back(frame * glm::dvec3(s * std::cos(a), c, s * std::sin(a)));
    }
}

// One point of each group of neighbours: its middle for one turn, else another one in every turn.
void TapPattern::spread_over_shape(const lighting::Disc& disc) {
  const int points = static_cast<int>(disc.shape.size());
  for (int turn = 0; turn < turns_; ++turn)
    for (int k = 0; k < taps_; ++k) {
      const int first = k * points / taps_, group = std::max(1, (k + 1) * points / taps_ - first);
      glm::dvec3 sum(0);
      for (int i = 0; i < group; ++i)
        if (turns_ == 1 || i == (turn * 5 + k * 3) % group)
          sum += disc.shape[static_cast<std::size_t>(first + i)];
      directions_.emplace_back(glm::normalize(sum));
    }
}

}  // namespace penumbra::shadows
