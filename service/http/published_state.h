// The newest of everything that a client may ask for.
// threads: thread-safe
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "capture/frames.h"
#include "core/environment.h"
#include "core/threads/stage_times.h"
#include "lighting/light_estimate.h"
#include "runtime/pipeline/runs.h"

namespace penumbra::service {

class PublishedState {
 public:
  using Clock = std::chrono::steady_clock;

  /// Of the source, once it is open. view_rate: frames a second that its view cameras send; 0:
  /// unknown
  void describe_source(std::vector<capture::CameraInfo> cameras, double view_rate);
  /// With all the lights that it needs, also those that frames have no time for.
  void publish_light(const lighting::LightEstimate& light);
  void publish(TimestampNs now, std::shared_ptr<const FramePixels> frame,
               const runtime::OvertakenFrames& overtaken = {});
  /// How far work on the scene has come, 0..1, by name; at 1 it is over.
  void publish_progress(const std::string& work, double done);
  /// What became of the frames of real cameras, by name.
  void publish_cameras(const std::vector<capture::CameraInfo>& cameras,
                       std::vector<capture::CameraCounts> counts);
  /// One way out of the picture.
  struct OutputState {
    std::string name;
    std::uint64_t shown = 0, overtaken = 0;  // frames
    std::string trouble;                     // why nothing comes out; empty: all is well
  };
  void publish_outputs(std::vector<OutputState> outputs);
  /// Where the poses of frames come from, in a rig whose cameras move.
  struct PoseState {
    std::string name;
    std::optional<double> age_s;  // of the newest pose; nothing before the first
    std::uint64_t accepted = 0, rejected = 0;
    std::uint64_t left_out = 0;  // environment frames without a pose
    double opacity = 1;          // of what is virtual in the newest frame
    std::string trouble;
    // Of the last pose that a frame got: one standard deviation, and how far beyond the newest one
    std::optional<double> sigma_mm{}, sigma_deg{}, extrapolated_ms{};
  };
  void publish_pose(PoseState pose);
  /// A headset that shows the picture.
  struct HeadsetView {
    std::string phase, runtime, headset;  // phase: "running", "idle" or "lost"
    double rate_hz = 0;
    std::uint64_t shown = 0, overtaken = 0, unmatched = 0, unplaced = 0, rejected = 0, restarts = 0;
    std::string trouble;
    std::vector<std::pair<std::string, StageTimes::Percentiles>> latency;
  };
  void publish_headset(HeadsetView headset);
  /// The map that a light comes from. It is copied at most five times a second, and only while
  /// somebody asks for it.
  void publish_environment(const Environment& environment);

  struct Snapshot {
    lighting::LightEstimate light;
    TimestampNs now;                           // capture time of the newest view frame
    std::shared_ptr<const FramePixels> frame;  // null before the first
    double idle_s = 0;                         // wall time since the last publication
    double uptime_s = 0;
    std::uint64_t frames = 0;
    double frame_rate_hz = 0;  // over the last two seconds
    double view_rate_hz = 0;   // that the source sends; 0: unknown
    runtime::OvertakenFrames overtaken;
    std::vector<capture::CameraInfo> sources;
    std::vector<std::pair<std::string, capture::CameraCounts>> cameras;  // real ones
    std::vector<OutputState> outputs;
    std::optional<PoseState> pose;
    std::optional<HeadsetView> headset;
    std::map<std::string, double> preparing;  // work that goes on, and how far it has come
    /// "starting" before any light, "stale" when light or frames stopped coming, "slow" when frames
    /// come at less than four fifths of the source's rate, else "ok".
    std::string status(double stale_after_s) const;
    double light_age_s() const;
  };
  Snapshot snapshot() const;
  /// Waits until there are more frames than so many; false after the timeout.
  bool wait_beyond(std::uint64_t frames, std::chrono::milliseconds timeout) const;
  /// Null before the first. Waits up to half a second for a new one where nobody asked lately.
  std::shared_ptr<const Environment> environment() const;

 private:
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  Snapshot state_;                      // guarded by mutex_, as are all below
  std::deque<Clock::time_point> came_;  // frames of the last seconds
  std::shared_ptr<const Environment> environment_;
  Clock::time_point environment_begun_{}, environment_made_{}, published_ = Clock::now();
  mutable Clock::time_point environment_wanted_{};
  const Clock::time_point started_ = Clock::now();
};

}  // namespace penumbra::service
