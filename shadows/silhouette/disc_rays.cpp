#include "shadows/silhouette/disc_rays.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/gtx/quaternion.hpp>

#include "core/aside.h"
#include "lighting/disc.h"
#include "core/conventions.h"

namespace penumbra::shadows {

namespace {
constexpr double kGoldenRatio = .6180339887498949;
}

double largest_angle(const lighting::Disc& disc) {
  double largest = disc.shape.empty() ? disc.radius.value() : 0;
  for (const glm::dvec3& d : disc.shape)
    largest = std::max(largest, std::acos(std::clamp(glm::dot(d, disc.direction), -1., 1.)));
  return largest;
}

double rms_angle(const lighting::Disc& disc) {
  if (disc.shape.empty()) return disc.radius.value() / std::sqrt(2.);
  double sum = 0;
  for (const glm::dvec3& d : disc.shape)
    sum += std::pow(std::acos(std::clamp(glm::dot(d, disc.direction), -1., 1.)), 2);
  return std::sqrt(sum / static_cast<double>(disc.shape.size()));
}

bool is_broad(const lighting::Disc& disc) {
  constexpr double kFrom = .05;  // radians
  return largest_angle(disc) >= kFrom;
}

namespace {

// Of an object's part as far as its radius.
bool is_wide(const lighting::Disc& disc, const Outline& outline, double edges) {
  return rms_angle(disc) * outline.radius_m() >= edges * outline.mean_length_m();
}

}  // namespace

bool is_smooth(const lighting::Disc& disc, const Outline& outline) {
  return is_wide(disc, outline, 1.75);
}
bool is_very_smooth(const lighting::Disc& disc, const Outline& outline) {
  return is_wide(disc, outline, 4);
}

Beam beam_of(const lighting::Disc& disc, double more) {
  return {disc.direction, std::sin(std::min(largest_angle(disc) + more, kPi / 2))};
}

bool may_hide(const BoundingSphere& one, const BoundingSphere& from, const lighting::Disc& disc) {
  const glm::dvec3 apart = one.centre - from.centre;
  const double far = glm::length(apart), both = one.radius + from.radius;
  if (far <= both) return true;
  const double aside = std::acos(std::clamp(glm::dot(apart / far, disc.direction), -1., 1.));
  return aside < std::asin(both / far) + largest_angle(disc);
}

BoundingSphere sphere_of(const Caster& caster) {
  return {caster.world_from_mesh * glm::dvec3(caster.outline->bounds().centre()),
          double(caster.outline->radius_m())};
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
      const double a = k * kGolden + 2 * kPi * std::fmod(turn * kGoldenRatio, 1.);
      directions_.emplace_back(frame * glm::dvec3(s * std::cos(a), c, s * std::sin(a)));
    }
}

// One point of each group of neighbours. Where one turn has to do its middle; else from turn to turn another one, on by the
// golden ratio and groups out of step, so that vertices beside each other together ask all of the shape. (Steps of five from turn
// to turn, three from group to group: 2.17 instead of 1.64 % on the knot under adams.)
void TapPattern::spread_over_shape(const lighting::Disc& disc) {
  constexpr double kOutOfStep = .7548776662466927;  // of the plane's golden ratio
  const std::size_t points = disc.shape.size(), taps = static_cast<std::size_t>(taps_);
  const auto middle = [&](std::size_t k) {
    const std::size_t first = k * points / taps, last = (k + 1) * points / taps;
    glm::dvec3 sum = disc.shape[first];
    for (std::size_t i = first + 1; i < last; ++i) sum += disc.shape[i];
    return glm::normalize(sum);
  };
  const auto one_of = [&](std::size_t k, std::size_t turn) {
    const double within = std::fmod(.5 + double(turn) * kGoldenRatio + double(k) * kOutOfStep, 1.);
    const double place = (double(k) + within) / double(taps) * double(points);
    return disc.shape[std::min(static_cast<std::size_t>(place), points - 1)];
  };
  for (std::size_t turn = 0; turn < static_cast<std::size_t>(turns_); ++turn)
    for (std::size_t k = 0; k < taps; ++k)
      directions_.emplace_back(turns_ == 1 || taps >= points ? middle(k) : one_of(k, turn));
}

}  // namespace penumbra::shadows
