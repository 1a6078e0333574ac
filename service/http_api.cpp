#include "service/http_api.h"

#include <fmt/format.h>
#include <httplib.h>
#include <sys/socket.h>

#include <algorithm>
#include <cctype>
#include <thread>

#include "codec/codec.h"
#include "codec/display.h"
#include "runtime/pipeline/report.h"
#include "service/internal/loopback.h"

namespace penumbra::service {

void PublishedState::publish(const lighting::LightEstimate& light, TimestampNs now,
                             std::shared_ptr<const FramePixels> frame,
                             const runtime::OvertakenFrames& overtaken) {
  const std::scoped_lock lock(mutex_);
  state_.light = light;
  state_.now = now;
  state_.frame = std::move(frame);
  ++state_.frames;
  state_.overtaken = overtaken;
  published_ = std::chrono::steady_clock::now();
}

void PublishedState::publish_progress(const std::string& work, double done) {
  const std::scoped_lock lock(mutex_);
  if (done < 1)
    state_.preparing[work] = done;
  else
    state_.preparing.erase(work);
}

void PublishedState::publish_cameras(const std::vector<capture::CameraInfo>& cameras,
                                     std::vector<capture::CameraCounts> counts) {
  const std::scoped_lock lock(mutex_);
  state_.cameras.clear();
  for (std::size_t i = 0; i < std::min(cameras.size(), counts.size()); ++i)
    state_.cameras.emplace_back(cameras[i].name, counts[i]);
}

PublishedState::Snapshot PublishedState::snapshot() const {
  const std::scoped_lock lock(mutex_);
  Snapshot out = state_;
  out.idle_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - published_).count();
  return out;
}

namespace {

// "starting" before any light, "stale" when light or frames stopped coming, else "ok".
std::string status_of(const PublishedState::Snapshot& s, double stale_after_s) {
  if (!s.light.valid) return "starting";
  return std::max(0., s.light.age(s.now).count()) + s.idle_s > stale_after_s ? "stale" : "ok";
}

nlohmann::json to_json(const capture::CameraCounts& c) {
  nlohmann::json out = {{"frames", c.frames},
                        {"lost", c.lost},
                        {"damaged", c.damaged},
                        {"rejected", c.rejected},
                        {"overrun", c.overrun},
                        {"reconnected", c.reconnected},
                        {"follows_exposure", !c.ignores_controls}};
  out["delay_frames"] = c.delay_frames ? nlohmann::json(*c.delay_frames) : nlohmann::json(nullptr);
  out["exposures_s"] = nlohmann::json::array();
  out["gains"] = nlohmann::json::array();
  for (const Exposure& e : c.exposures) {
    out["exposures_s"].push_back(e.time.count());
    out["gains"].push_back(e.gain.value());
  }
  if (c.light_error) out["light_error"] = *c.light_error;
  return out;
}

void reply(httplib::Response& response, const nlohmann::json& body, int status = 200) {
  response.status = status;
  // What a request says may be any bytes, and JSON is UTF-8.
  response.set_content(body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n",
                       "application/json");
}

// Against DNS rebinding: a page whose name was bound anew to a loopback address sends that name.
bool is_for_loopback(const httplib::Request& request) {
  std::string host = request.get_header_value("Host");
  std::ranges::transform(host, host.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (host.starts_with('[')) return is_loopback(host.substr(1, host.find(']') - 1));
  return is_loopback(host.substr(0, host.find(':')));
}

// The library's own options let a second server share the port and take half of the requests.
void let_address_be_reused(socket_t socket) {
  const int yes = 1;
  ::setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
}

}  // namespace

namespace {

// The newest frame as JPEG, encoded once however many clients ask.
class FrameJpeg {
 public:
  Result<std::shared_ptr<const std::string>> of(std::shared_ptr<const FramePixels> frame) {
    const std::scoped_lock lock(mutex_);
    if (frame_ != frame) {
      PENUMBRA_ASSIGN(jpeg, codec::encode_jpeg(codec::to_display(*frame)));
      bytes_ = std::make_shared<const std::string>(jpeg.begin(), jpeg.end());
      frame_ = std::move(frame);
    }
    return bytes_;
  }

 private:
  std::mutex mutex_;
  std::shared_ptr<const FramePixels> frame_;
  std::shared_ptr<const std::string> bytes_;
};

// Stage times are ranked once a second, however many clients ask.
class RecentStages {
 public:
  explicit RecentStages(const StageTimes& times) : times_(times) {}
  nlohmann::json now() {
    const std::scoped_lock lock(mutex_);
    const auto at = std::chrono::steady_clock::now();
    if (stages_.is_null() || at - made_ > std::chrono::seconds(1)) {
      stages_ = runtime::to_json(times_);
      made_ = at;
    }
    return stages_;
  }

 private:
  const StageTimes& times_;
  std::mutex mutex_;
  nlohmann::json stages_;
  std::chrono::steady_clock::time_point made_;
};

int status_of(ErrorCode code) {
  if (code == ErrorCode::kNotFound) return 404;
  return code == ErrorCode::kUnavailable ? 503 : 400;
}

void refuse(httplib::Response& response, const Error& error) {
  reply(response, {{"error", error.where + " " + error.detail}}, status_of(error.code));
}

}  // namespace

struct HttpApi::Impl {
  // Clients that keep their connection and say nothing hold one each, for kIdle_s.
  static constexpr std::size_t kWorkers = 64;
  static constexpr int kIdle_s = 1;

  httplib::Server server;
  FrameJpeg jpeg;
  std::unique_ptr<RecentStages> stages;
  std::jthread thread;
  int port = 0;

  void guard() {
    server.set_pre_routing_handler([](const httplib::Request& q, httplib::Response& r) {
      if (!is_for_loopback(q))
        reply(r, {{"error", "only requests to localhost or a loopback address are answered"}}, 403);
      else if (q.ranges.size() > 1)  // each would be answered, however often it is asked for
        reply(r, {{"error", "one range at a time is answered"}}, 416);
      else
        return httplib::Server::HandlerResponse::Unhandled;
      return httplib::Server::HandlerResponse::Handled;
    });
    server.set_exception_handler(
        [](const httplib::Request&, httplib::Response& r, const std::exception_ptr&) {
          reply(r, {{"error", "the request could not be answered"}}, 500);
        });
    server.set_socket_options(let_address_be_reused);
    server.set_tcp_nodelay(true);
    server.set_payload_max_length(1 << 16);
    server.set_read_timeout(5);
    server.set_write_timeout(5);
    server.set_keep_alive_timeout(kIdle_s);
    server.set_keep_alive_max_count(10'000);
    server.new_task_queue = [] { return new httplib::ThreadPool(kWorkers); };
  }

  void routes(const PublishedState& state, const StageTimes& times, double stale_after_s) {
    stages = std::make_unique<RecentStages>(times);
    server.Get("/healthz",
               [this, &state, stale_after_s](const httplib::Request&, httplib::Response& r) {
                 const auto s = state.snapshot();
                 const std::string status = status_of(s, stale_after_s);
                 nlohmann::json body = {{"status", status},
                                        {"frames", s.frames},
                                        {"dropped", runtime::to_json(s.overtaken)},
                                        {"stages", stages->now()}};
                 for (const auto& [work, done] : s.preparing) body["preparing"][work] = done;
                 for (const auto& [name, counts] : s.cameras)
                   body["cameras"][name] = to_json(counts);
                 reply(r, body, status == "ok" ? 200 : 503);
               });
    server.Get("/v1/light", [&state, stale_after_s](const httplib::Request&, httplib::Response& r) {
      const auto s = state.snapshot();
      if (!s.light.valid) return reply(r, {{"error", "no light has been measured yet"}}, 503);
      nlohmann::json body = runtime::to_json(s.light);
      body["time_ns"] = s.light.time.value;
      // A light may be newer than the newest view frame.
      body["age_s"] = std::max(0., s.light.age(s.now).count()) + s.idle_s;
      body["valid"] = s.light.valid;
      body["status"] = status_of(s, stale_after_s);
      body["units"] =
          "linear Rec.709, relative radiance; basis and index: real SH without Condon-Shortley "
          "phase, "
          "l*l+l+m, z the pole of a y-up world";
      reply(r, body);
    });
    server.Get("/v1/frame.jpg", [this, &state](const httplib::Request&, httplib::Response& r) {
      const auto s = state.snapshot();
      if (!s.frame) return reply(r, {{"error", "no frame has been composited yet"}}, 503);
      const auto bytes = jpeg.of(s.frame);
      if (!bytes) return reply(r, {{"error", bytes.error().detail}}, 500);
      r.set_content(**bytes, "image/jpeg");
    });
    errors();
  }

  // What a web page can send without being asked is no JSON: its changes are refused.
  void object_routes(SceneControl* objects) {
    server.Get("/v1/objects", [objects](const httplib::Request&, httplib::Response& r) {
      const nlohmann::json all = objects ? objects->objects() : nullptr;
      if (all.is_null()) return reply(r, {{"error", "the scene is still being prepared"}}, 503);
      reply(r, {{"objects", all}});
    });
    server.Patch("/v1/objects/(.+)", [objects](const httplib::Request& q, httplib::Response& r) {
      if (!q.get_header_value("Content-Type").starts_with("application/json"))
        return reply(r, {{"error", "the body must be application/json"}}, 415);
      const auto change = read_object_change(q.body);
      if (!change) return refuse(r, change.error());
      if (!objects) return reply(r, {{"error", "the scene is still being prepared"}}, 503);
      if (const auto done = objects->change(q.matches[1].str(), *change); !done)
        return refuse(r, done.error());
      reply(r, {{"objects", objects->objects()}});
    });
  }

  void errors() {
    server.set_error_handler([](const httplib::Request& q, httplib::Response& r) {
      if (!r.body.empty()) return;
      if (r.status == 404 && q.method != "GET" && q.method != "HEAD")
        reply(r, {{"error", "GET is answered, and PATCH at /v1/objects/NAME"}}, 405);
      else if (r.status == 404)
        reply(r, {{"error", fmt::format("nothing at {}", q.path.substr(0, 200))}}, 404);
      else
        reply(
            r,
            {{"error", r.status == 413 ? "the request is too large" : "the request is not valid"}},
            r.status);
    });
  }
};

HttpApi::HttpApi(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
HttpApi::~HttpApi() {
  if (impl_) impl_->server.stop();
}
int HttpApi::port() const {
  return impl_->port;
}

Result<std::unique_ptr<HttpApi>> HttpApi::start(const std::string& address, int port,
                                                const PublishedState& state,
                                                const StageTimes& times, double stale_after_s,
                                                SceneControl* objects) {
  auto impl = std::make_unique<Impl>();
  impl->guard();
  impl->routes(state, times, stale_after_s);
  impl->object_routes(objects);
  impl->port = port == 0 ? impl->server.bind_to_any_port(address) : port;
  const bool bound = port == 0 ? impl->port > 0 : impl->server.bind_to_port(address, port);
  if (!bound)
    return fail(ErrorCode::kUnavailable, fmt::format("{}:{}", address, port),
                "cannot be listened on: is it in use?");
  impl->thread = std::jthread([server = &impl->server] { server->listen_after_bind(); });
  // A stop before the server runs would be lost, and the destructor would wait for ever.
  for (int i = 0; i < 5000 && !impl->server.is_running(); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return std::unique_ptr<HttpApi>(new HttpApi(std::move(impl)));
}

}  // namespace penumbra::service
