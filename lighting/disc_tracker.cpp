#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <utility>

#include "lighting/disc.h"
#include "lighting/disc_tracker.h"
#include "core/scratch.h"

namespace penumbra::lighting {

namespace {

constexpr double kLargestMove = .07;  // radians between two maps, beyond the discs' own size
constexpr double kLargestRatio = 8;   // of irradiance between two maps
constexpr Seconds kRemember{1};       // a source that comes back within this keeps its number

double flux(const Disc& d) {
  return luminance(d.radiance) * d.solid_angle_sr();
}

bool is_near(const Disc& a, const Disc& b) {
  const double angle = std::acos(std::clamp(glm::dot(a.direction, b.direction), -1., 1.));
  return angle < kLargestMove + a.radius.value() + b.radius.value();
}

bool may_be_same(const Disc& a, const Disc& b) {
  const double ratio = flux(a) / std::max(flux(b), 1e-30);
  return is_near(a, b) && ratio < kLargestRatio && ratio > 1 / kLargestRatio;
}

}  // namespace

std::optional<std::size_t> DiscTracker::match(const Disc& disc, std::span<const char> taken) const {
  std::optional<std::size_t> best;
  double closest = -2;
  for (std::size_t k = 0; k < known_.size(); ++k) {
    const double cosine = glm::dot(known_[k].disc.direction, disc.direction);
    if (!taken[k] && cosine > closest && may_be_same(known_[k].disc, disc))
      closest = cosine, best = k;
  }
  return best;
}

int DiscTracker::number_of(const Disc& disc, TimestampNs time) {
  std::erase_if(lost_, [&](const Lost& l) { return time - l.since > kRemember; });
  const auto back =
      std::ranges::find_if(lost_, [&](const Lost& l) { return may_be_same(l.disc, disc); });
  if (back == lost_.end()) return next_id_++;
  const int id = back->disc.id;
  lost_.erase(back);
  return id;
}

void DiscTracker::update(TimestampNs time, double least_share, double mean_irradiance,
                         std::vector<Disc>& discs, std::vector<Disc>& left_over) {
  const double step = first_ ? 1 : std::clamp((time - time_) / kFade, 0., 1.);
  left_over.clear();
  const Scratch::Scope scope;
  std::pmr::vector<char> taken(known_.size(), 0, scope.memory());
  // Energy that was in the list and is not claimed yet: where sources part or join, it goes along.
  std::pmr::vector<double> unclaimed(scope.memory());
  for (const Known& k : known_) unclaimed.push_back(k.weight * flux(k.disc));
  found_.clear();
  for (const Disc& disc : discs) {  // the strongest chooses first
    const auto before = match(disc, taken);
    // A clipped source enters at any share: what is measured of it does not tell what it sends.
    if (!before && !disc.clipped && flux(disc) < least_share * mean_irradiance) {
      left_over.push_back(disc);
      continue;
    }
    if (before) {
      taken[*before] = 1;
      unclaimed[*before] = std::max(0., unclaimed[*before] - flux(disc));
    }
    found_.push_back({disc, before});
  }
  for (std::size_t k = 0; k < known_.size(); ++k)
    if (!taken[k]) lost_.push_back({known_[k].disc, time});
  now_.clear();
  for (auto& [disc, before] : found_) {
    const double own =
        before ? known_[*before].weight * std::min(flux(disc), flux(known_[*before].disc)) : 0;
    double carried = own;
    for (std::size_t k = 0; k < known_.size(); ++k) {
      if ((before && k == *before) || !is_near(known_[k].disc, disc)) continue;
      const double part = std::min(unclaimed[k], flux(disc) - carried);
      unclaimed[k] -= part;
      carried += part;
    }
    // A source that only brightened keeps its weight; one that a neighbour joined has what both had.
    const bool joined = carried > own;
    const double weight =
        before && !joined ? known_[*before].weight : carried / std::max(flux(disc), 1e-30);
    disc.id = before ? known_[*before].disc.id : number_of(disc, time);
    now_.push_back({disc, static_cast<float>(std::min(1., weight + step))});
  }
  std::swap(known_, now_);
  time_ = time;
  first_ = false;
  discs.clear();
  for (const Known& k : known_) {
    discs.push_back(k.disc);
    discs.back().radiance = k.disc.radiance * k.weight;
    if (k.weight == 1) continue;
    left_over.push_back(k.disc);
    left_over.back().radiance = k.disc.radiance * (1 - k.weight);
  }
}

}  // namespace penumbra::lighting
