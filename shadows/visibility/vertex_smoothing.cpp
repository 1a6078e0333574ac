#include "shadows/visibility/internal/vertex_smoothing.h"

#include <algorithm>
#include <cmath>

namespace penumbra::shadows {

namespace {

// Variances of visible fractions around a vertex, each with the weight of its open cosines.
struct Variances {
  float noise = 0;  // that its directions leave
  float all = 0;    // about what its neighbours average
  friend Variances operator+(Variances a, Variances b) {
    return {a.noise + b.noise, a.all + b.all};
  }
  friend Variances operator-(Variances a, Variances b) {
    return {a.noise - b.noise, a.all - b.all};
  }
};

float fraction(const prt::CosineSums& s) {
  return s.open > 0 ? s.seen / s.open : 0;
}

// Of a fraction by so many directions. Rays to a cap lie side by side, points of a form as they
// come.
float noise_of(float own, float around, int directions, bool stratified) {
  if (directions == 0) return 0;
  if (directions == 1) return around * (1 - around);  // it is 0 or 1 itself
  const auto n = static_cast<float>(directions);
  return own * (1 - own) / ((n - 1) * (stratified ? std::sqrt(n) : 1));
}

}  // namespace

void smooth_noise_over_neighbours(const prt::Mesh& mesh, const lighting::DistantLight& source,
                                  std::span<const std::uint8_t> directions,
                                  std::vector<prt::CosineSums>& sums) {
  const int times = smoothing_passes(source);
  thread_local std::vector<prt::CosineSums> around;  // grow once per thread
  thread_local std::vector<Variances> variances;
  around = sums;
  smooth_over_neighbours(mesh, times, around);
  variances.resize(sums.size());
  for (std::size_t i = 0; i < sums.size(); ++i) {
    const float own = fraction(sums[i]), mean = fraction(around[i]), off = own - mean;
    variances[i] = {sums[i].open * noise_of(own, mean, directions[i], source.shape.empty()),
                    sums[i].open * off * off};
  }
  // Of one ring alone both are too uncertain.
  smooth_over_neighbours(mesh, times + 1, variances);
  for (std::size_t i = 0; i < sums.size(); ++i) {
    if (sums[i].open <= 0) {  // all directions that it has are behind it
      sums[i] = around[i];
      continue;
    }
    const auto [noise, all] = variances[i];
    // Rounded, a variance may be a little below zero.
    const float mean = fraction(around[i]),
                kept = all > 0 ? std::clamp(1 - noise / all, 0.f, 1.f) : 0;
    sums[i].seen = sums[i].open * (mean + kept * (fraction(sums[i]) - mean));
  }
}

}  // namespace penumbra::shadows
