// Vertices that see a whole disc or nothing of it, so that a few rays answer for many.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "shadows/shadows.h"

namespace penumbra::shadows {

/// Along a surface what stands between it and a light changes only where an outline that is nearer to the light passes
/// over it (Appel 1967), or where surfaces cut through each other. Vertices over which none passes, joined by edges, form a
/// group.
/// threads: thread-bound; memory grows once
class SharedSight {
 public:
  static constexpr std::uint32_t kAlone = 0xffffffffu, kTurnedAway = 0xfffffffeu;

  /// Groups the vertices of `object`, which is one of the casters.
  void find(const Casters& casters, const Caster& object, const lighting::Disc& disc);

  /// By vertex: its group, kAlone, or kTurnedAway from all of the disc.
  std::span<const std::uint32_t> group() const { return group_; }
  /// By group: one of its vertices.
  std::span<const std::uint32_t> members() const { return members_; }
  std::size_t groups() const { return members_.size(); }
  /// Whether surfaces may cut through a group: where an outline does not know its cuts, or another caster reaches into the
  /// object's bounds. Then ask several of its vertices.
  bool may_be_cut() const { return may_be_cut_; }

 private:
  std::vector<std::uint32_t> group_, members_;
  bool may_be_cut_ = false;
};

}  // namespace penumbra::shadows
