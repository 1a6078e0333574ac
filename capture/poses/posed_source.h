// Frames of cameras that move, each with the pose of its own capture time.
// threads: next() and cameras() thread-bound; all else thread-safe
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "calib/camera/pose_file.h"
#include "capture/frames.h"
#include "capture/poses/pose_source.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// A camera that is fixed to the body.
struct MovingCamera {
  int camera = 0;  // index into FrameSource::cameras()
  Pose body_from_camera;
};

/// The cameras of a pose file that a source has; the body is the tracked one, or the file's first
/// camera.
/// path:   names the file in errors
/// errors: kInvalid (poses in the world, where nothing moves), kNotFound (none of the cameras)
Result<std::vector<MovingCamera>> moving_cameras(const std::vector<CameraInfo>& cameras,
                                                 const calib::PoseFile& file,
                                                 const std::filesystem::path& path);

struct PosedSourceOptions {
  std::vector<MovingCamera> cameras;
  Seconds tracker_offset{0};  // camera time + offset = the poses' time
};

/// Another source's frames. Of a camera that moves
///   world_from_camera = world_from_body(time + tracker_offset) * body_from_camera.
/// A view frame whose pose is not known keeps the last one, and what is virtual fades: from what
/// it was to 0 within 0.25 s of frame time, and back within 0.1 s. Before the first pose it is 0.
/// An environment frame whose pose is not known is left out.
class PosedSource : public FrameSource {
 public:
  /// errors: kInvalid (no camera, one that does not exist or is named twice, an offset beyond an
  ///         hour), kNonFinite
  static Result<std::unique_ptr<PosedSource>> create(std::unique_ptr<FrameSource> frames,
                                                     std::unique_ptr<PoseSource> poses,
                                                     const PosedSourceOptions& options);

  const std::vector<CameraInfo>& cameras() const override { return frames_->cameras(); }
  Result<std::optional<Frame>> next() override;
  double view_rate() const override { return frames_->view_rate(); }
  bool is_live() const override { return frames_->is_live(); }
  void close() override { frames_->close(); }
  bool take_darker(int camera, double factor) override {
    return frames_->take_darker(camera, factor);
  }
  Result<void> set_exposures(int camera, const std::vector<Exposure>& exposures) override {
    return frames_->set_exposures(camera, exposures);
  }
  std::vector<CameraCounts> counts() const override { return frames_->counts(); }

  PoseSourceState pose_state() const { return poses_->state(); }
  /// How sure the last pose is that a frame got; nothing before the first.
  /// threads: thread-safe
  std::optional<FramePose> last_pose() const {
    const std::scoped_lock lock(last_mutex_);
    return last_;
  }
  /// Environment frames without a pose.
  std::uint64_t left_out() const { return left_out_.load(std::memory_order_relaxed); }

 private:
  struct Mover {
    Pose body_from_camera, world_from_camera;  // the last that is known
    std::optional<TimestampNs> seen, known;    // times of its last frame, and of its last pose
    double opacity = 1, opacity_known = 1;     // of its last frame, and at its last pose
  };
  PosedSource(std::unique_ptr<FrameSource> frames, std::unique_ptr<PoseSource> poses)
      : frames_(std::move(frames)), poses_(std::move(poses)) {}
  static double fade(Mover& mover, TimestampNs time, bool known);

  std::unique_ptr<FrameSource> frames_;
  std::unique_ptr<PoseSource> poses_;
  Seconds offset_{0};
  std::vector<std::optional<Mover>> movers_;  // by camera
  std::atomic<std::uint64_t> left_out_{0};
  mutable std::mutex last_mutex_;
  std::optional<FramePose> last_;  // guarded by last_mutex_
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
