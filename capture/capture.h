// Cameras and what becomes of their frames: capture folders, the synthetic studio, HDR merge, and the
// assembly of a lat-long environment. Nothing here knows spherical harmonics.
// threads: classes are thread-bound (one thread at a time), free functions reentrant
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calib/calib.h"
#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::capture {

enum class Role { kEnvironment, kView };

struct CameraInfo {
  std::string name;
  Role role = Role::kEnvironment;
  std::string eye;  // "", "left" or "right"
  calib::Projection projection;
  calib::Response response;
  calib::NoiseModel noise;
  double black_level = 0;  // fraction of full scale
  Pose world_from_camera;
};

/// One frame with its own truth. Pixels are shared and never changed after capture.
struct Frame {
  int camera = 0;  // index into Capture::cameras
  std::uint64_t sequence = 0;
  TimestampNs time;
  Exposure exposure;  // APPLIED, not requested
  Pose world_from_camera;
  std::shared_ptr<const FramePixels> pixels;
};

int width(const FramePixels& pixels);
int height(const FramePixels& pixels);

/// A stream of frames of several cameras in order of time.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual const std::vector<CameraInfo>& cameras() const = 0;
  /// The next frame, or nothing at the end.
  virtual Result<std::optional<Frame>> next() = 0;
};

// ------------------------------------------------------------------------------ capture folder

/// Opens a folder with capture.toml (design in docs/capture-folder.md). Everything that can be checked
/// without decoding a picture is checked here: keys, sizes, exposures (positive, finite), times
/// (non-decreasing), files present.
/// errors: kNotFound, kInvalid (unknown key, bad value: file and line), kUnreadable
Result<std::unique_ptr<FrameSource>> open_capture_folder(const std::filesystem::path& folder);

/// Writes a capture folder frame by frame: 8 and 16 bit frames as PNG, float ones as EXR. capture.toml
/// is written by finish(), so an unfinished folder is not a capture.
class CaptureFolderWriter {
 public:
  /// errors: kUnwritable
  static Result<CaptureFolderWriter> create(const std::filesystem::path& folder,
                                            std::vector<CameraInfo> cameras);
  Result<void> write(const Frame& frame);
  Result<void> finish();

 private:
  CaptureFolderWriter() = default;
  std::filesystem::path folder_;
  std::vector<CameraInfo> cameras_;
  std::vector<std::string> rows_;  // one CSV text per camera
};

}  // namespace penumbra::capture
