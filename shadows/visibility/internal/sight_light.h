// A disc's light on an object by what its vertices are known to see past the object itself.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "lighting/disc.h"
#include "prt/geometry/plane.h"
#include "prt/transfer/vertex_sight.h"
#include "shadows/silhouette/casters.h"


namespace penumbra::shadows {

enum class SightUse { kNone, kScout, kCoarse, kFine };
/// Looked up in the sight's cells, wide or fine, for discs that are wide beside those; as a scout for smaller ones, but for those
/// that are told by outlines. None for hard shadows, for more rays than it is worth, and where another caster's sphere reaches
/// between: a real plane's, where there are several, always does.
SightUse use_of_sight(const Casters& casters, const Caster& object, const lighting::Disc& disc,
                      int taps);

/// By vertex, over directions of the disc; what is behind the plane does not count as seen.
/// in: cells as SightTaps::clear; averaged: whether neighbours share the light afterwards, and make do with fewer directions
/// threads: as trace_disc_light
void look_up(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc, int cells,
             bool averaged, std::span<prt::CosineSums> out);

/// The same where neighbours share light: only the mesh's samples look, and each vertex has what those at and beside it see.
/// One that grazes the disc stays dark where all of these are turned away from it.
void look_up_shared(const Caster& object, const prt::Plane* plane, const lighting::Disc& disc,
                    int cells, std::span<prt::CosineSums> out);

enum class SightVerdict : std::uint8_t { kTurnedAway, kDark, kLit, kMaybeDark, kMaybeLit, kMixed };
/// Lit or dark where samples at and beside a vertex agree that all of the disc, as finely as a look-up can tell, is open or that
/// nothing is; a sample maybe so where others say otherwise.
/// threads: as trace_disc_light
void scout(const Caster& object, const lighting::Disc& disc, std::vector<SightVerdict>& out);

}  // namespace penumbra::shadows
