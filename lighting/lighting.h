// Everything public of lighting: environments in, spherical harmonics and light sources out.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "lighting/estimate.h"                 // IWYU pragma: export
#include "lighting/governor.h"                 // IWYU pragma: export
#include "lighting/light_estimate.h"           // IWYU pragma: export
#include "lighting/light_filter.h"             // IWYU pragma: export
#include "lighting/lights/distant_light.h"     // IWYU pragma: export
#include "lighting/lights/light_extraction.h"  // IWYU pragma: export
#include "lighting/lights/light_tracker.h"     // IWYU pragma: export
#include "lighting/saturation_recovery.h"      // IWYU pragma: export
#include "lighting/sh/basis.h"                 // IWYU pragma: export
#include "lighting/sh/irradiance.h"            // IWYU pragma: export
#include "lighting/sh/map_average.h"           // IWYU pragma: export
#include "lighting/sh/map_luminance.h"         // IWYU pragma: export
#include "lighting/sh/projection.h"            // IWYU pragma: export
#include "lighting/sh/rotation.h"              // IWYU pragma: export
#include "lighting/sh/row_overlay.h"           // IWYU pragma: export
