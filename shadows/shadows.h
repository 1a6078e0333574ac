// Everything public of shadows.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "shadows/field/planar_shadow.h"          // IWYU pragma: export
#include "shadows/silhouette/occluders.h"         // IWYU pragma: export
#include "shadows/silhouette/shadow_map.h"        // IWYU pragma: export
#include "shadows/silhouette/silhouette_cache.h"  // IWYU pragma: export
#include "shadows/silhouette/silhouette_mesh.h"   // IWYU pragma: export
#include "shadows/visibility/direct_light.h"      // IWYU pragma: export
#include "shadows/visibility/lamp.h"              // IWYU pragma: export
