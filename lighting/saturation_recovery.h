// What light sources that clip every exposure really send.
// threads: free functions reentrant; RecoveryMemory thread-bound
#pragma once

#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/conventions.h"
#include "core/image.h"
#include "core/result.h"
#include "core/units.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

struct LightEstimate;

/// What a clipped source really sends: its radiance times its solid angle.
struct SaturationRecovery {
  int source = 0;  // its id
  Rgb power;
  // Together with other lights it is right. How they share it is a guess: nothing is promised, as
  // over a lower bound
  bool is_guess = false;
};

/// Of a clipped source's irradiance on the open surface, what arrives somewhere on it: 0 in its
/// shadow, above 1 where things reflect more of it there.
struct LightPart {
  int source = 0;  // its id
  Rgb part;
};

/// A part of a matte surface, with what things beside it do to its light.
struct ShadowRegion {
  Rgb radiance;                    // any scale where the albedo is not known and `beside` is none
  Rgb others{1, 1, 1};             // of the irradiance by all other light, what arrives
  Rgb beside{};                    // irradiance that arrives otherwise
  std::vector<LightPart> parts{};  // of clipped sources; of those that are not named: all
};

/// One surface, or more of one albedo, with the shadows on it.
struct ShadowedSurface {
  glm::dvec3 normal{0, 1, 0};
  std::span<const ShadowRegion> regions;
  std::optional<Rgb> albedo{};  // nothing: not known, and one of the unknowns
};
struct ShadowRecovery {
  std::vector<SaturationRecovery> powers;
  Rgb albedo;
};

/// The powers that agree best with all regions, and the albedo:
///   pi L_g / albedo = others_g E_others + beside_g + sum_j part_gj b_j Int cos+ over light j
/// What no shadow tells apart shares its part of the light in proportion to what was measured of
/// each. Where some are sun-like, among those alone: a sun or a bulb exceeds what saturates by
/// orders of magnitude, a window by little. The light on the surface comes out right, a division
/// among several is a guess (is_guess). A sun that no camera sees takes all of it, which may be
/// nothing.
/// errors:  kInvalid (no clipped light, a part of one that is not, bad normal or albedo),
///          kNonFinite, kUndetermined (the surface sees none of them, a region is black, the
///          shadows do not tell light and albedo apart)
/// source:  Debevec, Graham, Busch & Bolas 2012, with shadows for further surfaces
Result<ShadowRecovery> recover_from_shadows(const LightEstimate& light,
                                            const ShadowedSurface& surface);

inline constexpr Radians kSunRadius{.2666 * kPi / 180};
/// The id of a sun whose place is known and not seen. Nothing is measured of it: until its power is
/// recovered it sends nothing and is a lower bound.
inline constexpr int kUnseenSun = -1;
DistantLight unseen_sun(const glm::dvec3& direction);
/// A clipped region within this of its centre is taken for a sun: its size is the optics' doing.
inline constexpr Radians kSunLike{2 * kPi / 180};
/// The light with that power, in no channel less than was measured; with the sun's radius if small.
DistantLight completed(const DistantLight& measured, const Rgb& power);

/// Completions of tracked lights. Remembered is the radiance over the measured solid angle, so that
/// a source that is half covered later has half the power, and other exposures change nothing. A
/// sun that comes into view, or leaves it, keeps its power. A guess completes a light and leaves it
/// a lower bound.
/// threads: thread-bound
class RecoveryMemory {
 public:
  /// What the harmonics still have of a light that is fading in comes on top of the recovery.
  /// errors: kInvalid (not a clipped light of the newest map), kNonFinite, kUndetermined (less than
  ///         was measured)
  Result<void> remember(const SaturationRecovery& recovery);
  /// Completes the lights and what is left over of them; forgets lights that are clipped no longer.
  void apply(std::vector<DistantLight>& lights, std::span<DistantLight> unused);

 private:
  struct RecoveredLight {
    int source;
    glm::dvec3 direction;
    Rgb power;         // measured, a lower bound
    Rgb in_harmonics;  // of a light that is fading in: what the list does not have yet
    double solid_angle_sr;
    std::optional<Rgb> radiance;
    bool is_guess;  // the radiance
  };
  RecoveredLight* find(int source);
  RecoveredLight& add(const DistantLight& source, std::span<const DistantLight> present);
  std::vector<RecoveredLight> known_;
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
