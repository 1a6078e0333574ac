// Real cameras as one source of frames: each on a thread of its own, opened again when it comes
// back.
#pragma once

#include <filesystem>
#include <memory>
#include <thread>
#include <vector>

#include "capture/device/cameras.h"
#include "capture/frames.h"
#include "core/threads/queues.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Of a picture that shows both eyes side by side.
enum class StereoHalf { kLeft, kRight };

struct RigCamera {
  CameraInfo info;  // the projection has the size that is asked of the camera, or half of it
  std::optional<StereoHalf> half{};  // nothing: all of the picture
  CameraSettings settings;
  // In turn; one: fixed; none: as the camera stands, counted as one second
  std::vector<Exposure> schedule;
  // Instead: the fewest exposures that keep the light's error below this
  std::optional<double> light_error;
  std::optional<int> delay_frames;  // between a request and its effect; nothing: measured
};

/// The [[camera]] tables of a rig.toml (docs/reference/rig.md); other tables are left alone.
/// errors: kNotFound, kUnreadable, kInvalid (file, line, key)
Result<std::vector<RigCamera>> read_rig_cameras(const std::filesystem::path& path);

/// What opens cameras; another one in tests.
using OpenCamera = Result<std::unique_ptr<CameraDevice>> (*)(const CameraSettings&);

/// threads: next() and cameras() thread-bound; all others thread-safe
class Rig : public FrameSource {
 public:
  /// Two cameras of one device are the halves of its pictures: the first one's settings and
  /// exposures count for both.
  /// errors: as open_camera; kInvalid (a schedule for a camera whose exposure cannot be set, two
  ///         of one device that are not its halves, a half with light_error)
  static Result<std::unique_ptr<Rig>> open(std::vector<RigCamera> cameras,
                                           OpenCamera open = open_camera);
  ~Rig() override;

  const std::vector<CameraInfo>& cameras() const override { return infos_; }
  /// Waits for a frame of any camera; nothing after close(). A camera that has gone only stays
  /// silent: it is looked for four times a second until it is back.
  /// errors: kUnavailable (a camera's thread failed)
  Result<std::optional<Frame>> next() override;
  double view_rate() const override { return view_rate_; }
  bool is_live() const override { return true; }
  void close() override;
  bool take_darker(int camera, double factor) override;
  Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures) override;

  std::vector<CameraCounts> counts() const override;

 private:
  struct Station;
  Rig();
  Station& station_of(int camera);
  std::vector<CameraInfo> infos_;
  double view_rate_ = 0;
  Bounded<Frame> frames_;
  Latest<Error> failed_;  // of a thread, before frames_ is closed
  std::vector<std::unique_ptr<Station>> stations_;
  std::vector<std::size_t> station_of_;  // by camera
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
