// Light sources followed from map to map.
// threads: thread-bound
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "core/units.h"
#include "lighting/disc.h"

namespace penumbra::lighting {

/// Gives the same source the same number from map to map, and lets a source enter the list over kFade: what it
/// does not carry yet stays in the harmonics, so energy never jumps, only sharpness fades in. A source
/// enters at `DiscOptions::least_share` and leaves below half of it; where sources part or join, what was in the
/// list stays in it.
/// threads: thread-bound
class DiscTracker {
 public:
  static constexpr Seconds kFade{.2};

  /// in:  what split_discs found at half the least share, mean_irradiance = pi times the mean radiance
  /// out: `discs` holds what is used, its radiance times its weight; left_over the rest of it, as discs
  void update(TimestampNs time, double least_share, double mean_irradiance,
              std::vector<Disc>& discs, std::vector<Disc>& left_over);

 private:
  struct Known {
    Disc disc;
    float weight;
  };
  struct Lost {
    Disc disc;
    TimestampNs since;
  };
  struct Found {
    Disc disc;
    std::optional<std::size_t> before;  // in known_
  };
  std::optional<std::size_t> match(const Disc& disc, std::span<const char> taken) const;
  int number_of(const Disc& disc, TimestampNs time);

  std::vector<Known> known_, now_;
  std::vector<Lost> lost_;
  std::vector<Found> found_;
  TimestampNs time_;
  int next_id_ = 1;
  bool first_ = true;
};

}  // namespace penumbra::lighting
