// Everything public of shadows.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "shadows/field/occlusion_field.h"  // IWYU pragma: export
#include "shadows/field/planar_shadow.h"  // IWYU pragma: export
#include "shadows/silhouette/casters.h"  // IWYU pragma: export
#include "shadows/silhouette/disc_shadow.h"  // IWYU pragma: export
#include "shadows/silhouette/outline.h"  // IWYU pragma: export
#include "shadows/silhouette/outline_memo.h"  // IWYU pragma: export
#include "shadows/visibility/disc_points.h"  // IWYU pragma: export
#include "shadows/visibility/lamp.h"  // IWYU pragma: export
