// Everything public of calib: camera models and what estimates them.
// For programs and tests; the rooms themselves include what they need.
#pragma once

#include "calib/camera/calibration_files.h"         // IWYU pragma: export
#include "calib/camera/camera_model.h"              // IWYU pragma: export
#include "calib/camera/colour.h"                    // IWYU pragma: export
#include "calib/camera/lens_vignetting.h"           // IWYU pragma: export
#include "calib/camera/mirror_ball.h"               // IWYU pragma: export
#include "calib/camera/noise.h"                     // IWYU pragma: export
#include "calib/camera/pose_file.h"                 // IWYU pragma: export
#include "calib/camera/projection_table.h"          // IWYU pragma: export
#include "calib/camera/response.h"                  // IWYU pragma: export
#include "calib/estimate/boards.h"                  // IWYU pragma: export
#include "calib/estimate/camera_calibration.h"      // IWYU pragma: export
#include "calib/estimate/colour_calibration.h"      // IWYU pragma: export
#include "calib/estimate/estimate_response.h"       // IWYU pragma: export
#include "calib/estimate/latency.h"                 // IWYU pragma: export
#include "calib/estimate/noise_calibration.h"       // IWYU pragma: export
#include "calib/estimate/rig_calibration.h"         // IWYU pragma: export
#include "calib/estimate/vignetting_calibration.h"  // IWYU pragma: export
