// Known cameras of headsets: what they deliver, and where their calibration is.
// threads: reentrant
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace penumbra::calib {

struct CameraPreset {
  std::string_view usb_name;  // with which the name of the USB device begins
  std::string_view headset;
  int width, height;  // of a frame with both eyes
  std::string_view pixel_format;
  double rate_hz;
  bool side_by_side;             // the left eye's picture in the left half
  std::string_view calibration;  // where people find the file for import_camera()
};

/// usb_name: as the kernel tells it
std::optional<CameraPreset> find_camera_preset(std::string_view usb_name);
/// Two indented lines for people: what rig.toml says of it, and where its calibration is.
std::string advice(const CameraPreset& preset);

}  // namespace penumbra::calib
