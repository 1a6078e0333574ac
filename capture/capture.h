// Everything public of capture: cameras, recordings, HDR merge, environments, the synthetic studio.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "capture/camera_regions.h"                 // IWYU pragma: export
#include "capture/device/cameras.h"                 // IWYU pragma: export
#include "capture/device/rig.h"                     // IWYU pragma: export
#include "capture/environment/assembler.h"          // IWYU pragma: export
#include "capture/environment/common_surfaces.h"    // IWYU pragma: export
#include "capture/environment/environment_blend.h"  // IWYU pragma: export
#include "capture/environment/environment_file.h"   // IWYU pragma: export
#include "capture/frames.h"                         // IWYU pragma: export
#include "capture/hdr/merge.h"                      // IWYU pragma: export
#include "capture/hdr/stacks.h"                     // IWYU pragma: export
#include "capture/recording/folder.h"               // IWYU pragma: export
#include "capture/recording/recording.h"            // IWYU pragma: export
#include "capture/ring/hdr_ring.h"                  // IWYU pragma: export
#include "capture/studio/environments.h"            // IWYU pragma: export
#include "capture/studio/sensor.h"                  // IWYU pragma: export
#include "capture/studio/studio.h"                  // IWYU pragma: export
#include "capture/studio/world.h"                   // IWYU pragma: export
#include "capture/warp_grid.h"                      // IWYU pragma: export
