// Vertices that see a whole light or nothing of it, so that a few rays answer for many.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/threads/parallel.h"
#include "lighting/lights/distant_light.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/silhouette_mesh.h"
#include "shadows/visibility/internal/soft_shadow_volume.h"

namespace penumbra::shadows {

/// Along a surface what stands between it and a light changes only where a silhouette that is
/// nearer to the light passes over it (Appel 1967), or where surfaces cut through each other.
/// Vertices over which none passes, joined by edges, form a group. Of the others it counts which
/// part of the light silhouettes leave, where it knows all that are over them (SoftShadowVolume).
/// threads: thread-bound, parallel inside; memory grows once
class VisibilityGroups {
 public:
  static constexpr std::uint32_t kAlone = 0xffffffffu, kTurnedAway = 0xfffffffeu,
                                 kInPart = 0xfffffffdu;

  /// Whether find() counts what vertices in penumbras see (parts()): where the object casts no
  /// shadow aside by a cell on itself.
  static bool counts_parts(const Caster& object, const lighting::DistantLight& source);

  /// Groups the vertices of `object`, which is one of the casters. `samples` are the light's; a
  /// single one is its middle, which alone counts.
  void find(const ShadowCasters& casters, const Caster& object,
            const lighting::DistantLight& source, const SampleSet& samples);

  /// By vertex: its group, kAlone, kInPart where parts() tell how much it sees, or kTurnedAway from
  /// all of the light (from its only sample).
  std::span<const std::uint32_t> group() const { return group_; }
  std::size_t groups() const { return members_.size() / 2; }
  /// Two by two the first and the last vertex of each group.
  std::span<const std::uint32_t> members() const { return members_; }
  /// in: a vertex of a group
  bool is_member(std::size_t vertex) const {
    const std::size_t first = 2 * group_[vertex];
    return members_[first] == vertex || members_[first + 1] == vertex;
  }
  struct PartlyLit {
    std::size_t vertex;
    SoftShadowVolume::Answer seen;
  };
  std::span<const PartlyLit> parts() const { return parts_; }
  /// Whether surfaces may cut through a group: where a silhouette does not know its cuts, or the
  /// sphere around another caster meets the object's. Then ask several of its vertices.
  bool may_be_cut() const { return may_be_cut_; }

 private:
  template <class VertexView>
  void join_all(const SilhouetteMesh& silhouette, std::span<const std::uint8_t> faces,
                VertexView& view);
  void join(std::uint32_t first, std::uint32_t second);

  std::vector<std::uint32_t> group_, members_;
  std::vector<PartlyLit> parts_;
  std::vector<glm::vec3> places_;    // by vertex: in the grid
  std::vector<std::uint8_t> sides_;  // how it lies to the light
  bool may_be_cut_ = false;
};

}  // namespace penumbra::shadows
