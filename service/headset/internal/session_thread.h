// The session's thread: finds a runtime, runs its frames, and finds it again when it has gone.
// threads: thread-safe; run() is the thread
#pragma once

#include <atomic>
#include <condition_variable>
#include <future>
#include <mutex>
#include <optional>
#include <set>
#include <shared_mutex>
#include <stop_token>
#include <string>
#include <vector>

#include "core/threads/stage_times.h"
#include "service/headset/headset.h"
#include "service/headset/internal/device_history.h"
#include "service/headset/internal/eye_mailbox.h"
#include "service/headset/internal/head_session.h"
#include "service/headset/internal/picture_renderer.h"

namespace penumbra::service {

class SessionThread {
 public:
  explicit SessionThread(HeadsetOptions options);

  /// ready: gets what create() returns
  void run(const std::stop_token& stop, std::promise<Result<void>>& ready);

  void show(int eye, EyePicture picture);
  void set_distance(double distance_m) { distance_m_ = distance_m; }
  void set_floor(std::optional<double> height_m);
  std::optional<HeadPose> device_at(std::size_t device, TimestampNs time) const;
  HeadsetState state() const;

  static constexpr std::size_t kHead = 2;  // after the two hands

 private:
  Result<void> prepare();
  Result<void> live(const std::stop_token& stop);
  Result<void> live_with(const std::stop_token& stop, HeadSession& session, XrRuntime& runtime);
  Result<void> frame(HeadSession& session, XrRuntime& runtime);
  Result<void> sample_poses(HeadSession& session, XrRuntime& runtime);
  Result<void> take_picture(HeadSession& session, XrRuntime& runtime, XrTime display);
  Result<std::optional<EyeViews>> eyes_at(HeadSession& session, XrRuntime& runtime,
                                          TimestampNs captured, XrTime display) const;
  Result<void> draw(HeadSession& session, const EyePair& pair, const EyeViews& eyes);
  void add_latencies(const EyePair& pair, TimestampNs submitted, TimestampNs display);
  void set_phase(HeadsetPhase phase);
  void tell(const std::string& trouble);
  void pause(const std::stop_token& stop, Seconds time);

  const HeadsetOptions options_;
  std::atomic<double> distance_m_;
  EyeMailbox mailbox_;
  std::array<DeviceHistory, 3> histories_;  // left, right, head
  StageTimes latencies_;
  std::atomic<std::uint64_t> shown_ = 0, refused_ = 0, unplaced_ = 0;

  // For those who ask for poses: the session while it lives. Its end waits for them.
  mutable std::shared_mutex living_mutex_;
  HeadSession* living_ = nullptr;  // guarded by living_mutex_
  XrRuntime* runtime_ = nullptr;   // guarded by living_mutex_

  mutable std::mutex mutex_;
  std::condition_variable_any woken_;
  HeadsetState state_;  // guarded by mutex_, as are all below
  std::optional<double> floor_height_m_;
  std::set<std::string> refusals_;  // that were told

  // Of the thread alone.
  std::unique_ptr<HeadsetGraphics> graphics_;
  std::unique_ptr<PictureRenderer> renderer_;            // in the context of the graphics
  std::vector<XrCompositionLayerProjectionView> views_;  // that show the last picture
  std::optional<EyePair> just_drawn_;
  std::uint64_t sessions_ = 0;
};

}  // namespace penumbra::service
