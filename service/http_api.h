// The HTTP interface on loopback: GET /healthz, /v1/light, /v1/frame.jpg, /v1/objects, and PATCH
// /v1/objects/NAME.
// threads: PublishedState thread-safe, HttpApi thread-bound
#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "capture/device/cameras.h"
#include "capture/frames.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "lighting/light_estimate.h"
#include "runtime/pipeline/runs.h"
#include "service/scene_control.h"

namespace penumbra::service {

/// The newest of everything that a client may ask for.
/// threads: thread-safe
class PublishedState {
 public:
  void publish(const lighting::LightEstimate& light, TimestampNs now,
               std::shared_ptr<const FramePixels> frame,
               const runtime::OvertakenFrames& overtaken = {});
  /// How far work on the scene has come, 0..1, by name; at 1 it is over.
  void publish_progress(const std::string& work, double done);
  /// What became of the frames of real cameras, by name.
  void publish_cameras(const std::vector<capture::CameraInfo>& cameras,
                       std::vector<capture::CameraCounts> counts);

  struct Snapshot {
    lighting::LightEstimate light;
    TimestampNs now;                           // capture time of the newest view frame
    std::shared_ptr<const FramePixels> frame;  // null before the first
    double idle_s = 0;                         // wall time since the last publication
    std::uint64_t frames = 0;
    runtime::OvertakenFrames overtaken;
    std::vector<std::pair<std::string, capture::CameraCounts>> cameras;  // real ones
    std::map<std::string, double> preparing;  // work that goes on, and how far it has come
  };
  Snapshot snapshot() const;

 private:
  mutable std::mutex mutex_;
  Snapshot state_;  // guarded by mutex_
  std::chrono::steady_clock::time_point published_ = std::chrono::steady_clock::now();
};

/// Serves on a thread of its own until destroyed.
class HttpApi {
 public:
  /// port 0 takes any free one.
  /// errors: kUnavailable (address in use)
  /// in: all outlive it; without `objects` none are there
  static Result<std::unique_ptr<HttpApi>> start(const std::string& address, int port,
                                                const PublishedState& state,
                                                const StageTimes& times, double stale_after_s,
                                                SceneControl* objects = nullptr);
  ~HttpApi();
  int port() const;

 private:
  struct Impl;
  explicit HttpApi(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::service
