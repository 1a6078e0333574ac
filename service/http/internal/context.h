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

/// The newest frame as JPEG, encoded once however many clients ask.
class FrameJpeg {
 public:
  Result<std::shared_ptr<const std::string>> of(const std::shared_ptr<const FramePixels>& frame);

 private:
  std::mutex mutex_;
  std::shared_ptr<const FramePixels> frame_;
  std::shared_ptr<const std::string> bytes_;
};

/// The newest environment map as JPEG with a gain map, made once however many clients ask. What its
/// base is adapted to follows the light as an eye does, so that a row of them does not flicker.
class EnvironmentJpeg {
 public:
  Result<std::shared_ptr<const std::string>> of(const std::shared_ptr<const Environment>& map);

 private:
  std::mutex mutex_;
  tone::TemporalTone tone_{{.op = tone::ToneOperator::kPhotographic}};
  std::shared_ptr<const Environment> map_;
  std::shared_ptr<const std::string> bytes_;
};

/// The same as a cube.
class EnvironmentCube {
 public:
  static constexpr int kEdge = 128;  // texels
  Result<std::shared_ptr<const std::string>> of(const std::shared_ptr<const Environment>& map);

 private:
  std::mutex mutex_;
  std::optional<lighting::CubeMap> cube_;  // of the last map's size
  std::shared_ptr<const Environment> map_;
  std::shared_ptr<const std::string> bytes_;
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
  FrameJpeg jpeg;
  EnvironmentJpeg environment_jpeg;
  EnvironmentCube environment_cube;
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
