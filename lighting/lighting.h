// Everything public of lighting: environments in, spherical harmonics and light sources out.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "lighting/basis.h"                // IWYU pragma: export
#include "lighting/distant_light.h"        // IWYU pragma: export
#include "lighting/estimate.h"             // IWYU pragma: export
#include "lighting/governor.h"             // IWYU pragma: export
#include "lighting/irradiance.h"           // IWYU pragma: export
#include "lighting/light_estimate.h"       // IWYU pragma: export
#include "lighting/light_extraction.h"     // IWYU pragma: export
#include "lighting/light_filter.h"         // IWYU pragma: export
#include "lighting/light_tracker.h"        // IWYU pragma: export
#include "lighting/map_luminance.h"        // IWYU pragma: export
#include "lighting/projection.h"           // IWYU pragma: export
#include "lighting/rotation.h"             // IWYU pragma: export
#include "lighting/row_overlay.h"          // IWYU pragma: export
#include "lighting/saturation_recovery.h"  // IWYU pragma: export
