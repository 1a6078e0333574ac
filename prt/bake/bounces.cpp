#include <algorithm>
#include <array>
#include <span>
#include <utility>

#include "core/conventions.h"
#include "prt/bake/internal/baker.h"

namespace penumbra::prt {

static constexpr int kFloorAgainBands = 5;

// What of added_ arrives by one more reflection, into next_. far: what the receiver adds beyond its
// grid, or nothing.
void Baker::bounce(std::size_t index, const std::vector<BounceHit>& hits,
                   std::span<const float> far) {
  for (int c = 0; c < channels_; ++c) {
    float* const sum = &next_[place(index, c)];
    std::fill_n(sum, solved_, 0.f);
    for (const BounceHit& hit : hits) {
      const bool beyond = hit.point == BounceHit::kBeyond;
      const float albedo =
          beyond || is_ground_point(hit.point) ? floor_albedo_[c] : mesh_.albedo[hit.point][c];
      if (albedo == 0 || (beyond && far.empty())) continue;
      const float* const from = beyond ? far.data() : &added_[place(hit.point, c)];
      for (std::size_t n = 0; n < solved_; ++n) sum[n] += hit.weight * albedo * from[n];
    }
  }
}

// What of current_ comes by one reflection on a white receiver, into shadowed_.
void Baker::gather_from_floor(const std::vector<PointResult>& results, std::span<const float> far) {
  for_points(0, points_.size(), 0, [&](std::size_t index) {
    for (int c = 0; c < channels_; ++c) {
      float* const sum = &shadowed_[place(index, c)];
      std::fill_n(sum, solved_, 0.f);
      for (const BounceHit& hit : results[index].hits) {
        const bool beyond = hit.point == BounceHit::kBeyond;
        if (beyond ? far.empty() : !is_ground_point(hit.point)) continue;
        const float* const from = beyond ? far.data() : transfer_at(hit.point, c);
        for (std::size_t n = 0; n < solved_; ++n) sum[n] += hit.weight * from[n];
      }
    }
  });
}

// Solves current_ = shadowed_ + what current_ reflects, by bounces. Beyond its grid the receiver
// shows `far`, its first light, alone.
void Baker::bounce_all(const std::vector<PointResult>& results, int bounces,
                       std::span<const float> far, double progress) {
  current_ = added_ = shadowed_;
  if (bounces == 0) return;
  next_.assign(current_.size(), 0);
  std::array<double, 3> before{}, now = sum_of_constants(added_);
  for (int b = 0; b < bounces; ++b) {
    for_points(0, points_.size(), progress / bounces, [&](std::size_t i) {
      bounce(i, results[i].hits, b == 0 ? far : std::span<const float>());
      for (int c = 0; c < channels_; ++c)
        for (std::size_t n = place(i, c); n < place(i, c) + solved_; ++n) current_[n] += next_[n];
    });
    std::swap(added_, next_);
    before = std::exchange(now, sum_of_constants(added_));
  }
  if (bounces > 1) add_further_bounces(before, now);
}

// Summed over all points, by channel: under a constant light.
std::array<double, 3> Baker::sum_of_constants(const std::vector<float>& transfer) const {
  std::array<double, 3> sum{};
  for (std::size_t p = 0; p < points_.size(); ++p)
    for (int c = 0; c < channels_; ++c)
      sum[static_cast<std::size_t>(c)] += double(transfer[place(p, c)]);
  return sum;
}

// The bounces that are not traced: each is the one before, fainter by the same factor. Power
// iteration: what a bounce adds soon has the form of the scene's largest eigenvector, whatever the
// light.
void Baker::add_further_bounces(const std::array<double, 3>& before,
                                const std::array<double, 3>& last) {
  std::array<float, 3> further{};
  for (std::size_t c = 0; c < 3; ++c) {
    constexpr double kMaxFraction = .95;  // beyond, two bounces say too little
    const double q = before[c] > 0 ? std::clamp(last[c] / before[c], 0., kMaxFraction) : 0;
    further[c] = static_cast<float>(q / (1 - q));
  }
  for_points(0, points_.size(), 0, [&](std::size_t p) {
    for (int c = 0; c < channels_; ++c)
      for (std::size_t n = place(p, c); n < place(p, c) + solved_; ++n)
        current_[n] += further[static_cast<std::size_t>(c)] * added_[n];
  });
}

// t(rho) = sum_k rho^k t_k with t_k = (1 - A)^-1 G t_(k-1): G by one reflection on the white floor,
// A by the object. From the third on each is the one before times the echo.
void Baker::bake_floor(const std::vector<PointResult>& results, BakedObject& out) {
  const std::size_t vertices = mesh_.positions.size();
  gather_from_floor(results, ground_far_);
  bounce_all(results, options_.bounces, {}, .05);
  out.floor = packed(0, vertices, options_.reflected_bands);
  out.ground_floor = packed(vertices, points_.size() - vertices, options_.reflected_bands);
  // What comes to the floor a second time is faint, and nearly the same wherever it came from.
  const int few_bands = std::min(kFloorAgainBands, bands_);
  solved_ = static_cast<std::size_t>(coefficient_count(few_bands));
  gather_from_floor(results, {});
  bounce_all(results, options_.bounces, {}, 0);
  out.floor_again = packed(0, vertices, few_bands);
  out.ground_floor_again = packed(vertices, points_.size() - vertices, few_bands);
  const std::array<double, 3> twice = sum_of_constants(current_);
  gather_from_floor(results, {});
  bounce_all(results, options_.bounces, {}, 0);
  const std::array<double, 3> thrice = sum_of_constants(current_);
  for (int c = 0; c < 3; ++c) {
    const auto from = static_cast<std::size_t>(c < channels_ ? c : 0);
    if (twice[from] > 0)
      out.floor_echo[c] = static_cast<float>(std::clamp(thrice[from] / twice[from], 0., .95));
  }
}

}  // namespace penumbra::prt
