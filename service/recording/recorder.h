// From a source of frames into a recording, each camera coded on a thread of its own.
// threads: reentrant; `stop` may be set from any thread
#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "capture/frames.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::service {

struct RecordLimits {
  double seconds = 0;        // of the frames' own time; 0 = until stopped or the source ends
  std::uint64_t frames = 0;  // of all cameras; 0 = any
};

struct RecordCounts {
  std::vector<std::uint64_t> frames;           // written, one number a camera
  std::vector<std::uint64_t> dropped;          // came, but were not coded in time
  std::vector<std::uint64_t> faded;            // written, of these: their pose is old or unknown
  std::vector<capture::CameraCounts> cameras;  // of real ones
  double seconds = 0;                          // from the first frame's time to the last one's
  std::uint64_t bytes = 0;
};

/// Begins when each camera has shown a frame, so that all tracks are known. A live source is never
/// held up: what is not coded in time is dropped and counted; any other source waits.
/// on_progress: about once a second, from the calling thread.
/// errors: of source.next(); kUnwritable (the reason and what is kept); kUnavailable (a camera that
/// shows nothing within 10 s; only live)
Result<RecordCounts> record_frames(capture::FrameSource& source, const std::filesystem::path& path,
                                   RecordLimits limits, const std::atomic<bool>& stop,
                                   const std::function<void(const RecordCounts&)>& on_progress);

}  // namespace penumbra::service
