// Capture folders, read and written.
// threads: classes are thread-bound, free functions reentrant
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "capture/frames.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Opens a folder with capture.toml (design in docs/reference/capture-folder.md). Everything that
/// can be checked without decoding a picture is checked here: keys, sizes, exposures (positive,
/// finite), times (non-decreasing), files present.
/// errors: kNotFound, kInvalid (unknown key, bad value: file and line), kUnreadable
/// from: as open_recording's
Result<std::unique_ptr<FrameSource>> open_capture_folder(const std::filesystem::path& folder,
                                                         Seconds from = Seconds(0));

/// A camera on its own (for `render`): `version = 1` and one [[camera]] without frames.
/// errors: kNotFound, kUnreadable, kInvalid
Result<CameraInfo> read_camera_file(const std::filesystem::path& path);

/// Whether a finished capture stands there.
bool holds_capture(const std::filesystem::path& folder);

/// Writes a capture folder frame by frame: 8 and 16 bit frames as PNG, float ones as EXR.
/// capture.toml is written by finish(), so an unfinished folder is not a capture.
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
#pragma GCC visibility pop
