// Transfer of poses that nobody baked, traced while they play.
// threads: thread-bound, parallel inside
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include "core/result.h"
#include "prt/bake/bake.h"
#include "prt/geometry/animation.h"
#include "prt/geometry/receiver.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct BakedObject;

struct LiveBakeOptions {
  int bands = 5;
  std::optional<Receiver> receiver;
};

/// A running estimate of a character's transfer. Some points at a time are visited with a few rays;
/// what they find is kept in the material's frame, where it stays true for a while, and forgotten
/// as the character moves. So a pose that holds converges to what bake() gives with 1024 rays, and
/// one that moves is noisy or late, never of another pose. Light that is reflected is gathered from
/// the estimate itself: each update adds a bounce.
/// source: as bake(); running means after Nehab et al. 2007, reverse reprojection, which the
/// material makes exact here
class LiveBake {
 public:
  /// `character` must outlive it.
  /// errors: kInvalid (no triangles, bands, receiver), kUnavailable (Embree)
  static Result<LiveBake> create(const Character& character, const LiveBakeOptions& options);
  ~LiveBake();
  LiveBake(LiveBake&&) noexcept;

  static constexpr int kRays = 32;  // a visit
  /// Vertices and the receiver's texels.
  std::size_t points() const;
  /// Brings `out` to a pose: mesh, transfer, and with a receiver what the character takes from it.
  /// Points take turns; points() visits reach each of them once. A pose that is not finite is not
  /// taken: the one before holds.
  struct Cost {
    double rays_s = 0, fixed_s = 0;  // of the visits, and of what every update does
  };
  Cost update(const CharacterPose& pose, std::size_t visits, BakedObject& out);

 private:
  struct Impl;
  explicit LiveBake(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
