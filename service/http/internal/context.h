// What the handlers of requests share.
// threads: thread-safe
#pragma once

#include <httplib.h>

#include <atomic>
#include <chrono>
#include <mutex>
#include <nlohmann/json.hpp>
#include <string>

#include "core/threads/stage_times.h"
#include "service/http/http_api.h"
#include "service/http/internal/encoded_files.h"

namespace penumbra::service {

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
