// Direct light on an object from its visibility map.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"
#include "prt/transfer/visibility_map.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::shadows {

enum class LookupUse { kNone, kScout, kCoarse, kFine };
/// Looked up in the visibility's cells, wide or fine, for lights that are wide beside those; as a
/// scout for smaller ones, but for those that are told by silhouettes. None for hard shadows, for
/// more rays than it is worth, and where another caster's sphere reaches
/// between: a real plane's, where there are several, always does.
LookupUse lookup_use(const ShadowCasters& casters, const Caster& object,
                     const lighting::DistantLight& source, int samples);

/// By vertex, over directions of the light; what is behind the plane does not count as seen.
/// in: cells as VisibilitySamples::clear
/// threads: as trace_direct_light
void look_up(const Caster& object, const prt::Plane* plane, const lighting::DistantLight& source,
             int cells, std::span<prt::CosineSums> out);

enum class VisibilityVerdict : std::uint8_t {
  kTurnedAway,
  kDark,
  kLit,
  kMaybeDark,
  kMaybeLit,
  kMixed
};
/// Lit or dark where samples at and beside a vertex agree that all of the light, as finely as a
/// look-up can tell, is open or that nothing is; a sample maybe so where others say otherwise.
/// threads: as trace_direct_light
void scout(const Caster& object, const lighting::DistantLight& source,
           std::vector<VisibilityVerdict>& out);

}  // namespace penumbra::shadows
