// Private to capture: cameras behind the kernel's V4L2 drivers.
#pragma once

#include "capture/cameras.h"

namespace penumbra::capture {

void list_v4l2(CameraList& out);
Result<std::unique_ptr<CameraDevice>> open_v4l2(const CameraSettings& settings);

/// The mode that serves the settings best: size as asked for, then the frame rate, then the format that keeps most.
/// errors: kInvalid naming what is offered
Result<CameraMode> choose_mode(const CameraListing& camera, const CameraSettings& settings);

}  // namespace penumbra::capture
