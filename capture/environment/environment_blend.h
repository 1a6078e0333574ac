// Several pictures of the surroundings made one, without seams.
// threads: thread-bound
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/environment.h"
#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Mean of several lat-long maps, each weighted by the square of how far from its rim it was seen,
/// after gains that their overlaps tell. What is clipped in one and not in another counts there
/// alone.
/// source: gains from overlaps, Brown & Lowe 2007, section 6, here the median ratio of each pair
/// and channel
class EnvironmentBlend {
 public:
  explicit EnvironmentBlend(std::size_t views);
  /// How a view sees each pixel of the map from now on, 0 (not) to 1; all of one size, empty: not
  /// at all. Gains stay.
  void set_view(std::size_t view, Image<float> from_rim);

  /// One map a view, in their order; null: nothing of it yet.
  void blend(std::span<const Environment* const> views, Environment& out);
  /// What each view is multiplied by; the first is 1.
  const std::vector<Rgb>& gains() const { return gains_; }
  /// Whether a view's gain is known: it overlaps, by way of others perhaps, with the first.
  bool has_gain(std::size_t view) const { return has_gain_[view]; }

 private:
  struct Pair {
    std::size_t a, b;
    std::vector<std::uint32_t> pixels;  // some that both see well
  };
  using LogGains = std::array<double, 3>;  // by channel
  std::vector<std::optional<LogGains>> solve(std::span<const Environment* const> views) const;
  void pair_views();
  void follow_gains(std::span<const Environment* const> views);
  void add(std::size_t view, const Environment& map, std::uint32_t pixel, Environment& out);
  void add_measured(std::size_t view, const Environment& map, Environment& out);
  void add_bounds(std::span<const Environment* const> views, Environment& out);
  std::vector<Image<float>> weights_;
  std::vector<Pair> pairs_;
  bool paired_ = false;
  std::vector<LogGains> first_logs_;  // of the gains
  std::vector<Rgb> gains_;
  std::vector<bool> has_gain_;
  Image<float> total_;  // of the weights that count
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
