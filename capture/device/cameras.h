// Real cameras: what stands there, what it can do, its frames with the exposure that was applied.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

// ------------------------------------------------------------------------------ what is there

/// Distances of 16 bits: a camera gives them when it is asked for them.
inline constexpr const char* kDepthFormat = "Z16";

struct CameraMode {
  std::string format;  // four characters as the driver spells them: YUYV, NV12, MJPG, RG12, ...
  int width = 0, height = 0;
  double max_fps = 0;     // 0: the driver does not say
  bool readable = false;  // by us
};

struct ControlRange {
  double low = 0, high = 0;
};

/// A camera as the system shows it.
struct CameraListing {
  std::string device;        // what `device` in rig.toml takes: /dev/video0, libcamera:...
  std::string name, driver;  // as the driver gives them
  std::vector<CameraMode> modes;
  std::optional<ControlRange> exposure_s;  // seconds; nothing: the exposure cannot be set
  std::optional<ControlRange> gain;        // in the driver's own unit
};

/// All cameras that can stream, by V4L2 and then by libcamera, which may show the same ones; what
/// cannot be opened is left out with its reason in `rejected`.
struct CameraList {
  std::vector<CameraListing> cameras;
  std::vector<Error> rejected;
};
CameraList list_cameras();

// ------------------------------------------------------------------------------ one camera

struct CameraSettings {
  std::string device;
  std::string format;         // empty: the best that reaches `fps`
  int width = 0, height = 0;  // as the camera offers it
  double fps = 30;
  // The driver's value that counts as gain 1; 0: where it stands (libcamera: its least)
  double unit_gain = 0;
  double white_balance_k = 0;  // at which a V4L2 camera's is fixed; 0: the driver's preset
  // Else exposure, gain and white balance stay as they are: depth is best at the camera's own
  bool stop_automatics = true;
};

/// The driver's account of a frame.
struct CameraFrame {
  std::uint64_t sequence = 0;  // as the driver counts, gaps included
  TimestampNs time;            // CLOCK_MONOTONIC
  int damaged_before = 0;      // frames passed over since the last one: their transfer failed
  std::optional<Exposure> applied{};  // where the frame says so itself
};

/// A camera that streams from start to destruction.
/// threads: thread-bound
class CameraDevice {
 public:
  virtual ~CameraDevice() = default;
  virtual const std::string& name() const = 0;  // as in its listing
  /// What the camera makes of an exposure: its nearest time and gain.
  virtual Exposure nearest(Exposure wanted) const = 0;
  /// Asks for an exposure; it shows some frames later.
  /// errors: kInvalid (no such control), kClosed (the camera is gone)
  virtual Result<void> request(Exposure wanted) = 0;
  /// Waits for a frame whose time is at most `oldest` ago; what nobody took in time is gone.
  /// Nothing when none came.
  /// errors: kClosed (the camera is gone)
  virtual Result<std::optional<CameraFrame>> wait(Seconds timeout, Seconds oldest) = 0;
  /// The picture of the frame that wait() gave last, once.
  /// errors: kUnreadable (it came in part)
  virtual Result<FramePixels> pixels() = 0;
  /// What pixels() gave last as the camera coded it; nothing where it does not code.
  virtual std::shared_ptr<const std::vector<std::byte>> jpeg() const { return nullptr; }
  /// The clock of the frames' times.
  virtual TimestampNs now() const = 0;
};

/// Opens, negotiates and starts. Automatic exposure, gain and white balance are switched off where
/// there are such, and white balance is fixed by value where the driver takes one.
/// errors: kNotFound, kUnavailable (busy, not a capture device, no streaming, a white balance that
/// cannot be fixed), kInvalid (format, size or white balance not offered)
Result<std::unique_ptr<CameraDevice>> open_camera(const CameraSettings& settings);

}  // namespace penumbra::capture
#pragma GCC visibility pop
