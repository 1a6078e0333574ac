// Private to capture: a V4L2 device node, its modes and controls.
#pragma once

#include <linux/videodev2.h>
#include <sys/ioctl.h>

#include <cerrno>
#include <filesystem>
#include <optional>
#include <string>

#include "capture/device/cameras.h"
#include "capture/unique_fd.h"

namespace penumbra::capture {

/// An open device node. Methods answer with the driver's word and never print. The destructor of a
/// camera that was unplugged waits for the driver to let go of it, at most half a second.
class V4l2Node {
 public:
  V4l2Node(V4l2Node&&) noexcept = default;
  V4l2Node& operator=(V4l2Node&&) noexcept = default;
  ~V4l2Node();
  /// errors: kNotFound, kUnavailable (no rights, busy, no streaming), kInvalid (not a camera)
  static Result<V4l2Node> open(const std::string& device);

  /// ioctl that goes on after a signal; 0 or errno.
  template <class Argument>
  int call(unsigned long request, Argument* argument) const {
    int result;
    do {
      result = ::ioctl(fd_.get(), request, argument);
    } while (result < 0 && errno == EINTR);
    return result < 0 ? errno : 0;
  }
  int fd() const { return fd_.get(); }
  const std::string& device() const { return device_; }
  Error error(ErrorCode code, const std::string& what, int number) const;

  const std::string& name() const { return name_; }
  const std::string& driver() const { return driver_; }
  std::vector<CameraMode> modes() const;

  struct Control {
    std::uint32_t id;
    double low, high, step, preset;
  };
  std::optional<Control> control(std::uint32_t id) const;
  std::optional<int> value(std::uint32_t id) const;
  int set(std::uint32_t id, int value) const;  // 0 or errno

 private:
  V4l2Node() = default;
  double max_fps(std::uint32_t fourcc, std::uint32_t width, std::uint32_t height) const;
  UniqueFd fd_;
  std::string device_, name_, driver_;
  std::filesystem::path hardware_;  // its folder in /sys, which goes when it is unplugged
};

/// Exposure and gain of a camera in seconds and in the driver's unit.
struct V4l2Exposure {
  static constexpr double kUnit = 1e-4;  // seconds of V4L2_CID_EXPOSURE_ABSOLUTE
  std::optional<V4l2Node::Control> time, gain;
};
V4l2Exposure exposure_of(const V4l2Node& node);

/// The mode of this size that serves the settings best: by the frame rate, then by the format that
/// keeps most.
/// errors: kInvalid naming what is offered
Result<CameraMode> choose_mode(const std::vector<CameraMode>& modes,
                               const CameraSettings& settings);

/// Adds the cameras that V4L2 shows, in the order of their nodes.
void list_v4l2(CameraList& list);

/// As open_camera(), for a device node.
Result<std::unique_ptr<CameraDevice>> open_v4l2(const CameraSettings& settings);

}  // namespace penumbra::capture
