// Recordings: Matroska with a track of pictures and one of labels for each camera, so that any
// player shows them and a replay knows each frame's time, exposure and pose.
// docs/reference/recording.md
#pragma once

#include <filesystem>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "capture/frames.h"
#include "core/result.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// How a camera's pictures are kept. All but maps replay to the same pixels.
enum class Coding {
  kJpeg,   // as the camera coded them (Motion JPEG)
  kRgb8,   // losslessly coded here (FFVHUFF)
  kRgb16,  // the same at 16 bits
  kMap,    // a map of the surroundings, with loss (docs/methods/recordings.md)
};
/// errors: kInvalid (no picture, float pixels: they belong into a capture folder)
Result<Coding> coding_of(const Frame& frame);

/// Writes a recording under its own name from the first frame on. A frame whose write() returned
/// can be replayed, whatever ends the program.
/// threads: write() thread-safe, one thread at a time for each camera (coding runs in parallel);
/// the rest thread-bound
class RecordingWriter {
 public:
  /// codings: one a camera. view_rate: what FrameSource says, frames a second; 0 = unknown.
  /// errors: kUnwritable (exists already, no such folder), kInvalid (cameras' names), kUnavailable
  /// (coder)
  static Result<RecordingWriter> create(const std::filesystem::path& path,
                                        std::vector<CameraInfo> cameras,
                                        std::span<const Coding> codings, double view_rate);
  ~RecordingWriter();
  RecordingWriter(RecordingWriter&&) noexcept;
  RecordingWriter& operator=(RecordingWriter&&) noexcept;

  /// errors: kUnwritable (the system's reason: disk full), kInvalid (size, kind of pixels, time
  /// before the last one's)
  Result<void> write(const Frame& frame);
  /// Index and length, for players. Without it the recording lacks only these.
  /// errors: kUnwritable
  Result<void> finish();

  [[nodiscard]] std::uint64_t bytes() const;  // threads: thread-safe

 private:
  struct Impl;
  explicit RecordingWriter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Where a replay takes its light from.
enum class RecordedLight {
  kCameras,  // a light track is left out: pictures alone
  kTrack,    // maps that were measured while it was recorded; cameras of the surroundings are left
             // out
  kEither,   // the cameras where any shows the surroundings, else the track
  kBoth,     // all that is in there
};
/// Names as in options: auto, cameras, track.
/// errors: kInvalid naming the known ones
Result<RecordedLight> recorded_light(std::string_view name);

/// Frames in order of time. What a killed writer left behind ends with the last whole frame.
/// errors: kNotFound, kUnreadable (damaged, no Matroska), kInvalid (made by another program).
/// kInvalid too where nothing is left (no light track, or that alone).
/// from: after the first frame; view cameras begin there, and what tells the light two seconds
/// before it, or at the key map before that, so that there is light from the first picture on
/// next(): kUnreadable names the frame; the next call goes on behind it.
Result<std::unique_ptr<FrameSource>> open_recording(const std::filesystem::path& path,
                                                    RecordedLight light = RecordedLight::kCameras,
                                                    Seconds from = Seconds(0));

/// A capture folder, which has no light track, or a recording, whichever stands there.
/// errors: as open_capture_folder and open_recording
Result<std::unique_ptr<FrameSource>> open_capture(const std::filesystem::path& path,
                                                  RecordedLight light = RecordedLight::kCameras,
                                                  Seconds from = Seconds(0));

}  // namespace penumbra::capture
#pragma GCC visibility pop
