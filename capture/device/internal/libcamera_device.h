// Private to capture: cameras through libcamera, for those that V4L2 alone does not make pictures
// from (the sensors of single-board computers and of newer laptops). In rig.toml: device =
// "libcamera:ID", with the ID that `penumbra inspect cameras` shows.
#pragma once

#include <string_view>

#include "capture/device/cameras.h"

namespace penumbra::capture {

inline constexpr std::string_view kLibcamera = "libcamera:";
inline bool is_libcamera(std::string_view device) {
  return device.starts_with(kLibcamera);
}

/// Adds the cameras that libcamera finds.
void list_libcamera(CameraList& list);

/// As open_camera(), for a device that is_libcamera().
Result<std::unique_ptr<CameraDevice>> open_libcamera(const CameraSettings& settings);

}  // namespace penumbra::capture
