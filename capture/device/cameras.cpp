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
  if (is_libcamera(settings.device) && settings.white_balance_k > 0)
    return fail(ErrorCode::kInvalid, settings.device,
                "takes no white_balance_k, which is for V4L2 cameras");
  return is_libcamera(settings.device) ? open_libcamera(settings) : open_v4l2(settings);
}

}  // namespace penumbra::capture
