// What the handlers of requests share.
// threads: thread-safe
#pragma once

#include <httplib.h>

#include <atomic>
#include <filesystem>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "codec/tone/temporal_tone.h"
#include "core/environment.h"
#include "core/threads/stage_times.h"
#include "lighting/reflections/cube_map.h"
#include "service/http/http_api.h"

namespace penumbra::service {

/// A file that clients read.
struct EncodedFile {
  TimestampNs time;  // of the capture
  std::shared_ptr<const std::string> bytes;
};

/// The newest of something as a file, encoded once however many clients ask, and by one of them at
/// a time. Who waited for that gets the newer one.
template <class Source>
class NewestFile {
 public:
  template <class Encode>  // Result<std::string>(const Source&)
  Result<EncodedFile> of(const std::shared_ptr<const Source>& source, TimestampNs time,
                         const Encode& encode) {
    constexpr Seconds kOvertaken(1);  // further back a capture began anew
    const std::scoped_lock lock(mutex_);
    const Seconds step = source_ ? time - file_.time : Seconds(0);
    if (source_ == source || (step < Seconds(0) && step > -kOvertaken)) return file_;
    PENUMBRA_ASSIGN(bytes, encode(*source));
    file_ = {time, std::make_shared<const std::string>(std::move(bytes))};
    source_ = source;
    return file_;
  }

 private:
  std::mutex mutex_;
  std::shared_ptr<const Source> source_;
  EncodedFile file_;
};

using FramePointer = std::shared_ptr<const FramePixels>;
class FrameFiles {
 public:
  Result<EncodedFile> jpeg(const FramePointer& frame, TimestampNs time);
  Result<EncodedFile> png(const FramePointer& frame, TimestampNs time);

 private:
  NewestFile<FramePixels> jpeg_, png_;
};

/// The environment map. What the base of its JPEG with a gain map is adapted to follows the light
/// as an eye does, so that a row of them does not flicker.
using MapPointer = std::shared_ptr<const Environment>;
class EnvironmentFiles {
 public:
  static constexpr int kCubeEdge = 128;  // texels

  Result<EncodedFile> jpeg(const MapPointer& map);
  Result<EncodedFile> cube(const MapPointer& map);
  Result<EncodedFile> exr(const MapPointer& map);
  Result<EncodedFile> hdr(const MapPointer& map);

 private:
  NewestFile<Environment> jpeg_, cube_, exr_, hdr_;
  tone::TemporalTone tone_{{.op = tone::ToneOperator::kPhotographic}};  // in the lock of jpeg_
  TimestampNs toned_;                                                   // as well
  std::optional<lighting::CubeMap> faces_;  // of the last map's size; in the lock of cube_
};

/// Stage times, ranked once a second, however many clients ask.
class RecentStages {
 public:
  explicit RecentStages(const StageTimes& times) : times_(times) {}
  nlohmann::json now();

 private:
  const StageTimes& times_;
  std::mutex mutex_;
  nlohmann::json stages_;
  std::chrono::steady_clock::time_point made_;
};

struct HttpContext {
  // Each stream keeps a thread.
  static constexpr int kMaxStreams = 32;
  HttpContext(const HttpOptions& its_options, const HttpSources& its_sources)
      : options(its_options), sources(its_sources), stages(its_sources.times) {}
  const HttpOptions options;
  const HttpSources sources;
  FrameFiles frame_files;
  EnvironmentFiles environment_files;
  RecentStages stages;
  std::atomic<bool> stopping = false;
  std::atomic<int> streams = 0;
};

std::string lower(std::string text);
/// In JSON, with bytes that are no UTF-8 replaced: what a request says may be any bytes.
void reply(httplib::Response& response, const nlohmann::json& body, int status = 200);
void refuse(httplib::Response& response, const Error& error);

/// "GET, HEAD": what the description of the interface has at a path; empty: nothing.
std::string allowed_methods(const std::string& path);

void add_read_routes(httplib::Server& server, HttpContext& context);
void add_change_routes(httplib::Server& server, HttpContext& context);
void add_stream_routes(httplib::Server& server, HttpContext& context);
void add_page_routes(httplib::Server& server);

/// What /healthz says.
nlohmann::json health_json(HttpContext& context);
/// What /v1/light says; the light is valid.
nlohmann::json light_json(const PublishedState::Snapshot& now, double stale_after_s);
/// An event of /v1/events.
nlohmann::json state_json(HttpContext& context);
nlohmann::json to_json(const RecordingState& recording);
/// The text format of Prometheus, version 0.0.4.
std::string metrics_text(HttpContext& context);

}  // namespace penumbra::service
