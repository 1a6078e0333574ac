// The vignetting of a camera model's whole picture.
// threads: reentrant
#pragma once

#include <array>

#include "calib/camera/camera_model.h"
#include "calib/camera/vignetting.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// The vignetting of a camera with these terms: about its principal point if it has one.
Vignetting vignetting_of(const CameraModel& camera, const std::array<double, 3>& terms);
/// Whether V stays within 0.02..1.5 over the whole picture.
bool is_plausible(const Vignetting& vignetting, const CameraModel& camera);
/// The least of V over the whole picture.
double min_fraction(const Vignetting& vignetting, const CameraModel& camera);

}  // namespace penumbra::calib
#pragma GCC visibility pop
