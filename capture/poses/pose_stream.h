// Poses that another program sends, a line a datagram, over a local socket.
// threads: pose_of() and state() thread-safe; a thread of its own reads the socket
#pragma once

#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "capture/poses/pose_source.h"
#include "capture/unique_fd.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

struct PoseStreamOptions {
  std::filesystem::path socket;  // a Unix datagram socket that is made there; or
  std::optional<int> port;       // UDP on 127.0.0.1; 0: any that is free
  Seconds clock_offset{0};       // added to the sender's times; without meaning with `by_arrival`
  bool by_arrival = false;       // a pose has the time at which it arrives, CLOCK_MONOTONIC
  Seconds max_extrapolation{1 / 30.};  // one period of the frames
};

/// Lines are those of parse_pose_line(). Whatever arrives that is none is counted, and the first
/// told in the log. The kernel's buffer bounds what waits; poses go into a bounded history.
class PoseStream : public PoseSource {
 public:
  /// errors: kInvalid (both or none of socket and port, a port beyond 65535, a path longer than a
  ///         socket's name, an offset beyond 10^9 s), kUnavailable (the address is taken, no
  ///         rights)
  static Result<std::unique_ptr<PoseStream>> open(const PoseStreamOptions& options);
  ~PoseStream() override;
  PoseStream(const PoseStream&) = delete;
  PoseStream& operator=(const PoseStream&) = delete;

  std::optional<FramePose> pose_of(const Frame& frame) override;
  PoseSourceState state() const override;
  /// Of UDP, as it was bound; else 0.
  int port() const { return port_; }

 private:
  PoseStream(const PoseStreamOptions& options, std::string name);
  void run(const std::stop_token& stop) noexcept;
  void take(std::string_view datagram, TimestampNs arrival);

  const PoseStreamOptions options_;
  const std::string name_;
  UniqueFd socket_, wake_;
  int port_ = 0;
  bool made_file_ = false;
  mutable std::mutex mutex_;
  PoseHistory history_;       // guarded by mutex_, as are all below
  std::uint64_t unread_ = 0;  // datagrams that are no line
  std::optional<TimestampNs> asked_;
  bool said_ = false;
  std::jthread thread_;  // the last: it uses all above
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
