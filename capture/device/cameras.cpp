#include "capture/device/cameras.h"

#include "capture/device/internal/libcamera_device.h"
#include "capture/device/internal/v4l2_node.h"

namespace penumbra::capture {

CameraList list_cameras() {
  CameraList out;
  list_v4l2(out);
  list_libcamera(out);
  return out;
}

Result<std::unique_ptr<CameraDevice>> open_camera(const CameraSettings& settings) {
  return is_libcamera(settings.device) ? open_libcamera(settings) : open_v4l2(settings);
}

}  // namespace penumbra::capture
