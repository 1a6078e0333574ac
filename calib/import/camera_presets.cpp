#include "calib/import/camera_presets.h"

#include <fmt/format.h>

#include <array>

namespace penumbra::calib {

namespace {

constexpr std::array kCameraPresets = {
    CameraPreset{"3D Camera", "Valve Index", 1920, 960, "YUYV", 54, true,
                 "config/lighthouse/SERIAL/config.json in Steam's folder"}};

}  // namespace

std::optional<CameraPreset> find_camera_preset(std::string_view usb_name) {
  for (const CameraPreset& one : kCameraPresets)
    if (usb_name.starts_with(one.usb_name)) return one;
  return std::nullopt;
}

std::string advice(const CameraPreset& preset) {
  return fmt::format(
      "{}: {}x{} {} at {:g} frames a second{}\n"
      "lenses and poses: penumbra calibrate import FILE, of {}\n",
      preset.headset, preset.width, preset.height, preset.pixel_format, preset.rate_hz,
      preset.side_by_side ? "; half = \"left\" and half = \"right\" are its eyes" : "",
      preset.calibration);
}

}  // namespace penumbra::calib
