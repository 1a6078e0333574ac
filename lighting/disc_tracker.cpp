#include <algorithm>
#include <cmath>

#include "lighting/lighting.h"

namespace penumbra::lighting {

namespace {

constexpr double kLargestMove = .07;  // radians between two maps, beyond the discs' own size
constexpr double kLargestRatio = 8;   // of irradiance between two maps

double flux(const Disc& d) {
  return luminance(d.radiance) * d.solid_angle_sr();
}

bool may_be_same(const Disc& a, const Disc& b) {
  const double angle = std::acos(std::clamp(glm::dot(a.direction, b.direction), -1., 1.));
  const double ratio = flux(a) / std::max(flux(b), 1e-30);
  return angle < kLargestMove + a.radius.value() + b.radius.value() && ratio < kLargestRatio &&
         ratio > 1 / kLargestRatio;
}

}  // namespace

std::vector<Disc> DiscTracker::update(TimestampNs time, double least_share, double mean_irradiance,
                                      std::vector<Disc>& discs) {
  const double step = first_ ? 1 : std::clamp((time - time_) / kFade, 0., 1.);
  std::vector<Known> now;
  std::vector<Disc> left_over;
  for (Disc& disc : discs) {  // the strongest chooses first
    auto best = known_.end();
    double closest = -2;
    for (auto k = known_.begin(); k != known_.end(); ++k) {
      const double cosine = glm::dot(k->disc.direction, disc.direction);
      if (cosine > closest && may_be_same(k->disc, disc)) closest = cosine, best = k;
    }
    if (best == known_.end() && flux(disc) < least_share * mean_irradiance) {
      left_over.push_back(disc);
      continue;
    }
    float weight = static_cast<float>(step);
    if (best != known_.end()) {
      disc.id = best->disc.id;
      weight = std::min(1.f, weight + best->weight);
      known_.erase(best);
    } else {
      disc.id = next_id_++;
    }
    now.push_back({disc, weight});
  }
  known_ = std::move(now);
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
  return left_over;
}

}  // namespace penumbra::lighting
