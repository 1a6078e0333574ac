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

std::string advice(const CameraPreset& p) {
  const std::string frames =
      p.side_by_side
          ? fmt::format("two cameras of width = {} and height = {}, half = \"left\" and \"right\"",
                        p.width / 2, p.height)
          : fmt::format("width = {}, height = {}", p.width, p.height);
  return fmt::format(
      "  as in a {}: {}, format = \"{}\", fps = {:g}\n"
      "  its lenses and poses: penumbra calibrate import FILE, of {}\n",
      p.headset, frames, p.pixel_format, p.rate_hz, p.calibration);
}

}  // namespace penumbra::calib
