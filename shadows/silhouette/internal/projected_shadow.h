// Hard shadows of meshes on a plane from many directions at once, exact at every node of a grid.
#pragma once

#include <span>

#include "core/image.h"
#include "shadows/silhouette/internal/silhouette_segments.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/silhouette_cache.h"

namespace penumbra::shadows {

/// Adds at every node the weights of the directions that virtual things block and real ones don't
/// (`virtual_occlusion`), and of those that real ones block (`real_occlusion`, unless it is empty).
/// What stands lower than near_m blocks nothing.
/// threads: reentrant but for the cache; no allocation after a thread's largest call but its
/// source: shadows from points of the source averaged (Heckbert & Herf 1997), each drawn as the
/// winding number of its
/// silhouette: every triangle counts one layer in what it covers, and between two that face the
/// light alike the edge cancels
void add_projected_shadows(const ShadowCasters& casters, const NodeGrid& grid,
                           const SampleCone& light, SilhouetteCache& cache,
                           Image<float>& virtual_occlusion, Image<float>& real_occlusion);

}  // namespace penumbra::shadows
