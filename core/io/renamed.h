// Names of flags and keys that files and scripts of before may still use: refused, with the new
// name.
// threads: reentrant
#pragma once

#include <array>
#include <optional>
#include <string_view>

#pragma GCC visibility push(default)
namespace penumbra {

struct Renamed {
  std::string_view before, now;
};

inline constexpr std::array kRenamedKeys{
    Renamed{"blend_share", "blend_weight"}, Renamed{"budget", "max_shadow_error"},
    Renamed{"discs", "max_lights"},         Renamed{"field_deg", "fov_deg"},
    Renamed{"live_ms", "transfer_ms"},      Renamed{"prop", "real_mesh"},
    Renamed{"read_fraction", "read_noise"}, Renamed{"stand_size_m", "fit_size_m"},
};

inline constexpr std::array kRenamedFlags{
    Renamed{"--between", "--interpolation-error"},
    Renamed{"--board-lies", "--board-plane"},
    Renamed{"--budget", "--max-shadow-error"},
    Renamed{"--capped", "--dark"},
    Renamed{"--discs", "--max-lights"},
    Renamed{"--every", "--min-interval"},
    Renamed{"--prop", "--real-mesh"},
    Renamed{"--simultaneous", "--sync-tolerance"},
    Renamed{"--still-only", "--no-turntable"},
    Renamed{"--truncated-to", "--light-bands"},
};

template <std::size_t N>
constexpr std::optional<std::string_view> new_name(const std::array<Renamed, N>& list,
                                                   std::string_view before) {
  for (const Renamed& name : list)
    if (name.before == before) return name.now;
  return std::nullopt;
}

}  // namespace penumbra
#pragma GCC visibility pop
