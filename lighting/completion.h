// What light sources that clip every exposure really send.
// threads: free functions reentrant; CompletionMemory thread-bound
#pragma once

#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/conventions.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"
#include "lighting/disc.h"
#include "lighting/light_estimate.h"

namespace penumbra::lighting {

struct LightEstimate;

/// What a clipped source really sends: its radiance times its solid angle.
struct Completion {
  int disc = 0;  // its id
  Rgb power;
};

/// A matte surface of known albedo that nothing shades, on the scale of the environment's radiance.
struct KnownPatch {
  glm::dvec3 normal{0, 1, 0};
  Rgb radiance;
  Rgb albedo;
};

/// A matte surface on both sides of the edge of the shadow that something real casts in the light
/// of one clipped source. Any scale, any albedo.
struct ShadowEdge {
  glm::dvec3 normal{0, 1, 0};
  Rgb lit, shadowed;
};

/// All clipped discs at once, channel by channel, not negative:
/// E_p - E_unclipped,p = sum_j b_j Int cos+ over disc j.
/// errors:  kInvalid (no clipped disc, bad patch: which), kNonFinite, kUndetermined (fewer patches
///          than clipped discs, no patch sees a disc, patches that do not tell discs apart, nothing
///          left for a disc)
/// source:  Debevec, Graham, Busch & Bolas 2012; least squares of Lawson & Hanson 1974
Result<std::vector<Completion>> complete_from_patches(const LightEstimate& light,
                                                      std::span<const KnownPatch> patches);
/// What one patch says of several clipped discs: they send what it misses, each in proportion to what was measured of
/// it. Where some are sun-like, those alone: a sun or a bulb exceeds what saturates by orders of magnitude, a window by
/// little. The light on the patch comes out right, its share between the discs is a guess.
/// errors:  kInvalid, kNonFinite as complete_from_patches, kUndetermined (the patch sees none of them, nothing left)
Result<std::vector<Completion>> complete_together(const LightEstimate& light,
                                                  const KnownPatch& patch);
/// E_disc = E_others (lit / shadowed - 1).
/// errors:  kInvalid (not a clipped disc, bad edge), kNonFinite, kUndetermined (the surface does not
///          see the disc, the lit side is not brighter)
Result<Completion> complete_from_shadow(const LightEstimate& light, int disc,
                                        const ShadowEdge& edge);

inline constexpr Radians kSunRadius{.2666 * kPi / 180};
/// A clipped region within this of its centre is taken for a sun: its size is the optics' doing.
inline constexpr Radians kSunLike{2 * kPi / 180};
/// The disc with that power, in no channel less than was measured; with the sun's radius if small.
Disc completed(const Disc& measured, const Rgb& power);

/// Completions of tracked discs. Remembered is the radiance over the measured solid angle, so that a
/// source that is half covered later has half the power, and other exposures change nothing.
/// threads: thread-bound
class CompletionMemory {
 public:
  /// errors: kInvalid (not a clipped disc of the newest map), kNonFinite, kUndetermined (less than
  ///         was measured)
  Result<void> remember(const Completion& completion);
  /// Completes the discs and what is left over of them; forgets discs that are clipped no longer.
  void apply(std::vector<Disc>& discs, std::span<Disc> left_over);

 private:
  struct Known {
    int disc;
    Rgb power;  // measured, a lower bound
    double solid_angle_sr;
    std::optional<Rgb> radiance;
  };
  Known* find(int disc);
  std::vector<Known> known_;
};

}  // namespace penumbra::lighting
