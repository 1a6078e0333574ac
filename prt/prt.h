// Everything public of prt: geometry, transfer, bakes, clips, the path-traced reference.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "prt/bake/bake.h"                    // IWYU pragma: export
#include "prt/bake/baked_file.h"              // IWYU pragma: export
#include "prt/clip/key_frames.h"              // IWYU pragma: export
#include "prt/clip/light_map.h"               // IWYU pragma: export
#include "prt/clip/live_bake.h"               // IWYU pragma: export
#include "prt/clip/sequence.h"                // IWYU pragma: export
#include "prt/geometry/animation.h"           // IWYU pragma: export
#include "prt/geometry/ground_grid.h"         // IWYU pragma: export
#include "prt/geometry/luminous.h"            // IWYU pragma: export
#include "prt/geometry/mesh.h"                // IWYU pragma: export
#include "prt/geometry/pinhole_view.h"        // IWYU pragma: export
#include "prt/geometry/plane.h"               // IWYU pragma: export
#include "prt/geometry/receiver.h"            // IWYU pragma: export
#include "prt/rays/rays.h"                    // IWYU pragma: export
#include "prt/reference/environment_light.h"  // IWYU pragma: export
#include "prt/reference/reference.h"          // IWYU pragma: export
#include "prt/transfer/relight.h"             // IWYU pragma: export
#include "prt/transfer/transfer.h"            // IWYU pragma: export
#include "prt/transfer/transfer_pca.h"        // IWYU pragma: export
#include "prt/transfer/visibility_map.h"      // IWYU pragma: export
