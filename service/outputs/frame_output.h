// The composited picture into other programs, each output on a thread of its own.
// threads: thread-safe
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "core/image.h"
#include "core/result.h"
#include "core/threads/queues.h"
#include "core/units.h"

namespace penumbra::service {

class FrameSink;

/// One way out. It never slows whoever shows frames: what it cannot take in time, newer frames
/// replace. What ends an output is told once in the log and leaves the others alone.
class FrameOutput {
 public:
  /// YUV4MPEG2, 4:2:0 with the range of video and the matrix of BT.709, at a constant rate: frames
  /// are repeated or left out so that each stands where its capture time puts it.
  /// target:  "-" for standard output, else a path; a FIFO waits for its reader
  /// rate_hz: frames a second of the source; 0: unknown, counts as 30
  /// errors:  kInvalid (the rate), kUnwritable
  static Result<std::unique_ptr<FrameOutput>> to_y4m(const std::string& target, double rate_hz);

  /// A V4L2 output device such as v4l2loopback's.
  /// errors: kNotFound, kUnavailable (no rights, not a video device), kInvalid (takes no pictures,
  ///         or none in a format that this knows)
  static Result<std::unique_ptr<FrameOutput>> to_v4l2(const std::string& device);

  struct PipeWireNode {
    std::string name;                      // node.name, of letters, digits, '.', '_' and '-'
    std::string description = "Penumbra";  // what people read in lists of cameras
    double rate_hz = 0;                    // of the source; 0: unknown, counts as 30
  };
  /// A camera of PipeWire, whose buffers carry the capture time. Frames are converted only while
  /// somebody watches. A server that is not there, or goes away, is looked for every two seconds.
  /// errors: kInvalid (the name, the rate), kUnavailable (the library itself)
  static Result<std::unique_ptr<FrameOutput>> to_pipewire(const PipeWireNode& node);

  /// name: of the output in log lines
  FrameOutput(std::string name, std::unique_ptr<FrameSink> sink);
  /// Ends the output, also while its consumer is stuck.
  ~FrameOutput();
  FrameOutput(const FrameOutput&) = delete;
  FrameOutput& operator=(const FrameOutput&) = delete;

  /// Never waits. captured: rises from frame to frame
  void show(std::shared_ptr<const FramePixels> pixels, TimestampNs captured);

  /// Frames that nobody watches, or that a constant rate leaves out, count as neither.
  struct OutputCounts {
    std::uint64_t shown = 0;      // handed to the other program
    std::uint64_t overtaken = 0;  // by newer ones before they were
  };
  OutputCounts counts() const;
  const std::string& name() const { return name_; }
  /// Why nothing comes out; empty while all is well.
  std::string trouble() const;
  /// True once it has failed for good.
  bool ended() const;

 private:
  struct Shown {
    std::shared_ptr<const FramePixels> pixels;
    TimestampNs captured;
  };
  void run(const std::stop_token& stop);
  Result<void> serve(const std::stop_token& stop);
  void tell(const std::string& trouble);

  const std::string name_;
  std::unique_ptr<FrameSink> sink_;  // of the thread alone
  Latest<Shown> newest_;
  mutable std::mutex mutex_;
  std::string trouble_;  // guarded by mutex_, as are all below
  bool ended_ = false;
  std::uint64_t shown_ = 0;
  std::jthread thread_;  // the last: it uses all above
};

}  // namespace penumbra::service
