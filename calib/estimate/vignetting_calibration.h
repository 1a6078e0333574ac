// Estimation of a lens's vignetting from pictures of an even surface.
// threads: reentrant
#pragma once

#include <array>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/camera/lens_vignetting.h"
#include "calib/camera/response.h"
#include "calib/camera/vignetting.h"
#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

struct EvenPicture {
  std::string name;
  FramePixels pixels;  // 8 or 16 bits, or linear
};

struct VignettingCalibration {
  Vignetting vignetting;
  double corner = 1, corner_sigma = 0;  // V in the corners, and one standard deviation of it
  double residual = 0;                  // RMS of the blocks, relative
  /// By distance from the centre in half diagonals: what was seen, evened out by each picture's own
  /// slope.
  struct Ring {
    double distance = 0, seen = 0;
  };
  std::vector<Ring> rings;
};

/// From pictures of a surface that is lit evenly, or evenly slanted: each picture may have a
/// brightness and a slope of its own.
/// errors: kInvalid (sizes, none), kUndetermined (dark, clipped, not even: says which and what to
/// do)
Result<VignettingCalibration> calibrate_vignetting(std::span<const EvenPicture> pictures,
                                                   const CameraModel& camera,
                                                   const Response& response, double black_level);

/// "version = 1" and [vignetting]: terms, corner, corner_sigma.
std::string print_vignetting_file(const VignettingCalibration& calibration);
}  // namespace penumbra::calib
#pragma GCC visibility pop
