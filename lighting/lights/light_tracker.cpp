#include <algorithm>
#include <cmath>
#include <memory_resource>
#include <utility>

#include "core/threads/scratch.h"
#include "lighting/lights/distant_light.h"
#include "lighting/lights/light_tracker.h"

namespace penumbra::lighting {

namespace {

constexpr double kLargestMove = .07;  // radians between two maps, beyond the lights' own size
constexpr double kLargestRatio = 8;   // of irradiance between two maps
constexpr Seconds kRemember{1};       // a source that comes back within this keeps its number

double flux(const DistantLight& d) {
  return luminance(d.radiance) * d.solid_angle_sr();
}

bool is_near(const DistantLight& a, const DistantLight& b) {
  const double angle = std::acos(std::clamp(glm::dot(a.direction, b.direction), -1., 1.));
  return angle < kLargestMove + a.radius.value() + b.radius.value();
}

bool may_be_same(const DistantLight& a, const DistantLight& b) {
  const double ratio = flux(a) / std::max(flux(b), 1e-30);
  return is_near(a, b) && ratio < kLargestRatio && ratio > 1 / kLargestRatio;
}

}  // namespace

std::optional<std::size_t> LightTracker::match(const DistantLight& source,
                                               std::span<const char> taken) const {
  std::optional<std::size_t> best;
  double closest = -2;
  for (std::size_t k = 0; k < known_.size(); ++k) {
    const double cosine = glm::dot(known_[k].source.direction, source.direction);
    if (!taken[k] && cosine > closest && may_be_same(known_[k].source, source))
      closest = cosine, best = k;
  }
  return best;
}

int LightTracker::number_of(const DistantLight& source, TimestampNs time) {
  std::erase_if(lost_, [&](const Lost& l) { return time - l.since > kRemember; });
  const auto back =
      std::ranges::find_if(lost_, [&](const Lost& l) { return may_be_same(l.source, source); });
  if (back == lost_.end()) return next_id_++;
  const int id = back->source.id;
  lost_.erase(back);
  return id;
}

void LightTracker::update(TimestampNs time, double min_irradiance_fraction, double mean_irradiance,
                          std::vector<DistantLight>& lights, std::vector<DistantLight>& unused) {
  const double step = first_ ? 1 : std::clamp((time - time_) / kFade, 0., 1.);
  unused.clear();
  const Scratch::Scope scope;
  std::pmr::vector<char> taken(known_.size(), 0, scope.memory());
  // Energy that was in the list and is not claimed yet: where sources part or join, it goes along.
  std::pmr::vector<double> unclaimed(scope.memory());
  for (const TrackedLight& k : known_) unclaimed.push_back(k.weight * flux(k.source));
  found_.clear();
  for (const DistantLight& source : lights) {  // the strongest chooses first
    const auto before = match(source, taken);
    // A clipped source enters at any fraction: what was measured does not tell what it sends.
    if (!before && !source.clipped && flux(source) < min_irradiance_fraction * mean_irradiance) {
      unused.push_back(source);
      continue;
    }
    if (before) {
      taken[*before] = 1;
      unclaimed[*before] = std::max(0., unclaimed[*before] - flux(source));
    }
    found_.push_back({source, before});
  }
  for (std::size_t k = 0; k < known_.size(); ++k)
    if (!taken[k]) lost_.push_back({known_[k].source, time});
  now_.clear();
  for (auto& [source, before] : found_) {
    const double own =
        before ? known_[*before].weight * std::min(flux(source), flux(known_[*before].source)) : 0;
    double carried = own;
    for (std::size_t k = 0; k < known_.size(); ++k) {
      if ((before && k == *before) || !is_near(known_[k].source, source)) continue;
      const double part = std::min(unclaimed[k], flux(source) - carried);
      unclaimed[k] -= part;
      carried += part;
    }
    // A source that only brightened keeps its weight; one that a neighbour joined has what both
    // had.
    const bool joined = carried > own;
    const double weight =
        before && !joined ? known_[*before].weight : carried / std::max(flux(source), 1e-30);
    source.id = before ? known_[*before].source.id : number_of(source, time);
    now_.push_back({source, static_cast<float>(std::min(1., weight + step))});
  }
  std::swap(known_, now_);
  time_ = time;
  first_ = false;
  lights.clear();
  for (const TrackedLight& k : known_) {
    lights.push_back(k.source);
    lights.back().radiance = k.source.radiance * k.weight;
    if (k.weight == 1) continue;
    unused.push_back(k.source);
    unused.back().radiance = k.source.radiance * (1 - k.weight);
  }
}

}  // namespace penumbra::lighting
