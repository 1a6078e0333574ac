// Calibrations of other programs and devices: JSON, YAML and XML.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "calib/import/import_camera.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace penumbra;
  const auto rig = calib::parse_camera_import({reinterpret_cast<const char*>(data), size}, "fuzz");
  if (!rig) return 0;
  if (rig->cameras.empty()) __builtin_trap();
  for (const calib::ImportedCamera& one : rig->cameras) {
    if (one.camera.width < 1 || !(one.camera.focal_px.x > 0)) __builtin_trap();
    if (!std::isfinite(one.camera.principal_px.x + one.camera.distortion[0])) __builtin_trap();
    if (one.body_from_camera && !(std::abs(glm::length(one.body_from_camera->rotation) - 1) < 1e-6))
      __builtin_trap();
  }
  return 0;
}
