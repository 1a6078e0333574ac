#include "capture/environment/environment_blend.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>

#include "core/conventions.h"
#include "core/median.h"

namespace penumbra::capture {

namespace {

constexpr std::size_t kMaxPixels = 2048;  // of an overlap: its median is known to a few per mille
constexpr std::size_t kFewestPixels = 16;
// Of a new round's gains, after the first: what walks past must not flicker
constexpr double kStep = .1;

bool is_clipped(const Environment& e, std::uint32_t pixel) {
  return std::ranges::binary_search(e.clipped, pixel);
}

// log(a / b) of each channel where both are measured well.
std::optional<std::array<double, 3>> log_ratio(const Environment& a, const Environment& b,
                                               std::span<const std::uint32_t> pixels) {
  std::array<std::vector<double>, 3> logs;
  double mean = 0;
  for (const std::uint32_t i : pixels)
    mean += double(luminance(a.radiance.pixels()[i])) / double(pixels.size());
  for (const std::uint32_t i : pixels) {
    if (is_clipped(a, i) || is_clipped(b, i)) continue;
    const Rgb &one = a.radiance.pixels()[i], &other = b.radiance.pixels()[i];
    if (!(luminance(one) > .1 * mean)) continue;  // the dark has the noise
    for (int c = 0; c < 3; ++c)
      if (one[c] > 0 && other[c] > 0)
        logs[static_cast<std::size_t>(c)].push_back(std::log(double(one[c]) / double(other[c])));
  }
  std::array<double, 3> out{};
  for (std::size_t c = 0; c < 3; ++c) {
    if (logs[c].size() < kFewestPixels) return std::nullopt;
    out[c] = median(logs[c]);
  }
  return out;
}

}  // namespace

EnvironmentBlend::EnvironmentBlend(std::size_t views)
    : weights_(views), first_logs_(views), gains_(views, Rgb{1, 1, 1}), has_gain_(views, false) {
  has_gain_[0] = true;
}

void EnvironmentBlend::set_view(std::size_t view, Image<float> from_rim) {
  if (!from_rim.empty() && !total_.same_size(from_rim))
    total_ = Image<float>(from_rim.width(), from_rim.height());
  weights_[view] = std::move(from_rim);
  for (float& v : weights_[view].pixels()) v *= v;
  paired_ = false;
}

void EnvironmentBlend::pair_views() {
  pairs_.clear();
  for (std::size_t a = 0; a < weights_.size(); ++a)
    for (std::size_t b = a + 1; b < weights_.size(); ++b) {
      if (weights_[a].empty() || weights_[b].empty()) continue;
      std::vector<std::uint32_t> common;
      for (std::uint32_t i = 0; i < total_.area(); ++i)
        if (std::min(weights_[a].pixels()[i], weights_[b].pixels()[i]) > 0) common.push_back(i);
      Pair pair{a, b, {}};
      const std::size_t step = common.size() / kMaxPixels + 1;
      for (std::size_t i = 0; i < common.size(); i += step) pair.pixels.push_back(common[i]);
      if (pair.pixels.size() >= kFewestPixels) pairs_.push_back(std::move(pair));
    }
  paired_ = true;
}

// Log gains by least squares of log g_a + log a = log g_b + log b over all overlaps, by
// Gauss-Seidel with the first fixed; nothing for a view that no overlap ties to it.
std::vector<std::optional<EnvironmentBlend::LogGains>> EnvironmentBlend::solve(
    std::span<const Environment* const> views) const {
  struct Tie {
    std::size_t a, b;
    LogGains log_ratio;
    double pixels;
  };
  std::vector<Tie> ties;
  for (const Pair& pair : pairs_) {
    if (!views[pair.a] || !views[pair.b]) continue;
    const auto ratio = log_ratio(*views[pair.a], *views[pair.b], pair.pixels);
    if (ratio) ties.push_back({pair.a, pair.b, *ratio, double(pair.pixels.size())});
  }
  std::vector<std::optional<LogGains>> logs(views.size());
  logs[0] = LogGains{};
  constexpr int kRounds = 50;
  for (int round = 0; round < kRounds && !ties.empty(); ++round)
    for (std::size_t v = 1; v < views.size(); ++v) {
      LogGains sum{};
      double weight = 0;
      for (const Tie& t : ties) {
        if (t.a != v && t.b != v) continue;
        const auto& other = logs[t.a == v ? t.b : t.a];
        if (!other) continue;
        for (std::size_t c = 0; c < 3; ++c)
          sum[c] += t.pixels * ((*other)[c] + (t.a == v ? -1 : 1) * t.log_ratio[c]);
        weight += t.pixels;
      }
      if (weight == 0) continue;
      for (double& c : sum) c /= weight;
      logs[v] = sum;
    }
  return logs;
}

// A gain that wanders off by two stops is a camera that somebody covered, not a gain.
void EnvironmentBlend::follow_gains(std::span<const Environment* const> views) {
  const double largest = std::log(4.);
  const auto logs = solve(views);
  for (std::size_t v = 1; v < views.size(); ++v) {
    if (!logs[v]) continue;
    if (!has_gain_[v]) first_logs_[v] = *logs[v];
    for (std::size_t c = 0; c < 3; ++c) {
      if (std::abs((*logs[v])[c] - first_logs_[v][c]) > largest) continue;
      float& gain = gains_[v][static_cast<int>(c)];
      const double wanted = std::exp((*logs[v])[c]);
      gain =
          static_cast<float>(has_gain_[v] ? gain * std::pow(wanted / double(gain), kStep) : wanted);
    }
    has_gain_[v] = true;
  }
}

void EnvironmentBlend::add(std::size_t view, const Environment& map, std::uint32_t pixel,
                           Environment& out) {
  const float w = weights_[view].pixels()[pixel];
  out.radiance.pixels()[pixel] += map.radiance.pixels()[pixel] * gains_[view] * w;
  total_.pixels()[pixel] += w;
}

void EnvironmentBlend::add_measured(std::size_t view, const Environment& map, Environment& out) {
  auto clipped = map.clipped.begin();
  const auto seen = [&](std::uint32_t i) {
    return map.confidence.empty() || map.confidence.pixels()[i] > 0;
  };
  for (std::uint32_t i = 0; i < total_.area(); ++i) {
    if (clipped != map.clipped.end() && *clipped == i)
      ++clipped;
    else if (weights_[view].pixels()[i] > 0 && seen(i))
      add(view, map, i, out);
  }
}

// Lower bounds count where there is nothing better.
void EnvironmentBlend::add_bounds(std::span<const Environment* const> views, Environment& out) {
  out.clipped.clear();
  for (const Environment* map : views)
    if (map)
      std::ranges::copy_if(map->clipped, std::back_inserter(out.clipped),
                           [&](std::uint32_t i) { return total_.pixels()[i] == 0; });
  std::ranges::sort(out.clipped);
  out.clipped.erase(std::ranges::unique(out.clipped).begin(), out.clipped.end());
  double solid_angle_sr = 0;
  for (const std::uint32_t i : out.clipped) {
    for (std::size_t v = 0; v < views.size(); ++v)
      if (views[v] && is_clipped(*views[v], i)) add(v, *views[v], i, out);
    solid_angle_sr +=
        latlong_solid_angle(static_cast<int>(i) / total_.width(), total_.width(), total_.height());
  }
  out.clipped_fraction = solid_angle_sr / (4 * kPi);
}

void EnvironmentBlend::blend(std::span<const Environment* const> views, Environment& out) {
  if (!paired_) pair_views();
  follow_gains(views);
  if (out.radiance.width() != total_.width() || out.radiance.height() != total_.height())
    out.radiance = Image<Rgb>(total_.width(), total_.height());
  std::ranges::fill(out.radiance.pixels(), Rgb{});
  std::ranges::fill(total_.pixels(), 0.f);
  double black = 0;
  int there = 0;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (!views[v]) continue;
    add_measured(v, *views[v], out);
    black += views[v]->black_fraction, ++there;
  }
  out.black_fraction = black / std::max(1, there);
  add_bounds(views, out);
  for (std::size_t i = 0; i < total_.area(); ++i)
    if (float& total = total_.pixels()[i]; total > 0) {
      out.radiance.pixels()[i] = out.radiance.pixels()[i] * (1 / total);
      total = 1;
    }
  const bool whole = std::ranges::find(total_.pixels(), 0.f) == total_.pixels().end();
  out.confidence = whole ? Image<float>{} : total_;
}

}  // namespace penumbra::capture
