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

/// What an object's visibility map does under a light.
enum class LookupUse { kNone, kScout, kScoutAmongOthers, kCoarse, kFine };
/// kCoarse, kFine: the light is wide against the map's coarse or fine cells, so the map answers in
/// place of rays. kScout: the light is smaller, and the map tells which vertices need rays.
/// kScoutAmongOthers: another caster's sphere reaches between, so that the map tells only what is
/// dark. Where there are several real planes, one of their spheres always does. kNone: there is no
/// map, the shadow is hard, or more than eight rays a vertex are asked for.
LookupUse lookup_use(const ShadowCasters& casters, const Caster& object,
                     const lighting::DistantLight& source, int samples);

/// By vertex, over directions of the light that are not behind the plane.
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
/// What the samples (prt::VertexSamples) at and beside each vertex say of a light, as finely as a
/// look-up can tell. kLit, kDark: all of them say that the whole light is open, or nothing of it.
/// kMaybeLit, kMaybeDark: the vertex is a sample and says so, but others say otherwise.
/// threads: as trace_direct_light
void scout(const Caster& object, const lighting::DistantLight& source,
           std::vector<VisibilityVerdict>& out);

}  // namespace penumbra::shadows
