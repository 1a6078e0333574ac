// Vertices that see a whole disc or nothing of it, so that a few rays answer for many.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "shadows/shadows.h"

namespace penumbra::shadows {

/// Along a surface what stands between it and a light changes only where an outline that is nearer to the light passes
/// over it (Appel 1967), or where surfaces cut through each other. Vertices over which none passes, joined by edges, form a
/// group. The outlines are those of up to seventeen directions of the disc. Surfaces that cut through each other are not
/// looked for: who uses a group asks several of its vertices.
/// threads: thread-bound; memory grows once
class SharedSight {
 public:
  static constexpr std::uint32_t kAlone = 0xffffffffu, kTurnedAway = 0xfffffffeu;

  /// Groups the vertices of `object`, which is one of the casters.
  void find(const Casters& casters, const Caster& object, const lighting::Disc& disc);

  /// By vertex: its group, kAlone, or kTurnedAway from all of the disc.
  std::span<const std::uint32_t> group() const { return group_; }
  std::size_t groups() const { return count_; }

 private:
  std::vector<std::uint32_t> group_;
  std::size_t count_ = 0;
};

}  // namespace penumbra::shadows
