// Records what a live run sees, beside it, when somebody asks for it.
// threads: thread-safe
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "capture/frames.h"
#include "core/result.h"
#include "runtime/pipeline/light_track.h"
#include "service/recording/recorder.h"

namespace penumbra::service {

struct RecordingState {
  std::string file;  // in the folder
  RecordCounts counts;
  std::uint64_t overrun = 0;  // frames that came faster than they were taken
  bool active = true;
  std::string error;  // why it ended, where it did not end well
};

class LiveRecording {
 public:
  /// folder: where recordings and snapshots go; made when it is needed
  explicit LiveRecording(std::filesystem::path folder) : folder_(std::move(folder)) {}
  ~LiveRecording();

  /// The source as before, from which frames are also recorded. Both outlive it.
  std::unique_ptr<capture::FrameSource> tap(capture::FrameSource& source);

  /// name: of the file, without folder, ending in .mkv; empty: by date and time
  /// light: its maps are measured beside the run's own, on the recording's thread
  /// out: the file's name
  /// errors: kInvalid (a bad name, a file that is there), kUnavailable (one goes on already, no
  ///         source yet), kUnwritable
  Result<std::string> start(const std::string& name,
                            runtime::KeptLight light = runtime::KeptLight::kCameras);
  /// Waits until the file is whole.
  /// errors: kNotFound (none goes on); of the recording
  Result<RecordingState> stop();
  /// The one that goes on or the last one; nothing before the first.
  std::optional<RecordingState> state() const;
  /// A name that is free in the folder, which is made.
  /// errors: kUnwritable
  Result<std::filesystem::path> new_file(const std::string& stem, const std::string& extension);

 private:
  class Branch;
  class Tap;
  void end_thread();
  const std::filesystem::path folder_;
  std::mutex control_mutex_;  // one start, stop or end at a time; before mutex_
  mutable std::mutex mutex_;
  capture::FrameSource* source_ = nullptr;  // guarded by mutex_, as are all below
  std::shared_ptr<Branch> branch_;          // while one goes on
  std::optional<RecordingState> state_;
  std::atomic<bool> stop_ = false;
  std::jthread thread_;
};

}  // namespace penumbra::service
