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
  return s.light.age(s.now).count() + s.idle_s > stale_after_s ? "stale" : "ok";
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

struct HttpApi::Impl {
  httplib::Server server;
  std::jthread thread;
  int port = 0;

  void guard() {
    server.set_pre_routing_handler([](const httplib::Request& q, httplib::Response& r) {
      if (is_for_loopback(q)) return httplib::Server::HandlerResponse::Unhandled;
      reply(r, {{"error", "only requests to localhost or a loopback address are answered"}}, 403);
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
  }

  void routes(const PublishedState& state, const StageTimes& times, double stale_after_s) {
    server.Get("/healthz",
               [&state, &times, stale_after_s](const httplib::Request&, httplib::Response& r) {
                 const auto s = state.snapshot();
                 const std::string status = status_of(s, stale_after_s);
                 nlohmann::json body = {{"status", status},
                                        {"frames", s.frames},
                                        {"dropped", runtime::to_json(s.overtaken)},
                                        {"stages", runtime::to_json(times)}};
                 for (const auto& [name, counts] : s.cameras)
                   body["cameras"][name] = to_json(counts);
                 reply(r, body, status == "ok" ? 200 : 503);
               });
    server.Get("/v1/light", [&state, stale_after_s](const httplib::Request&, httplib::Response& r) {
      const auto s = state.snapshot();
      if (!s.light.valid) return reply(r, {{"error", "no light has been measured yet"}}, 503);
      nlohmann::json body = runtime::to_json(s.light);
      body["time_ns"] = s.light.time.value;
      body["age_s"] = s.light.age(s.now).count() + s.idle_s;
      body["valid"] = s.light.valid;
      body["status"] = status_of(s, stale_after_s);
      body["units"] =
          "linear Rec.709, relative radiance; basis and index: real SH without Condon-Shortley "
          "phase, "
          "l*l+l+m, z the pole of a y-up world";
      reply(r, body);
    });
    server.Get("/v1/frame.jpg", [&state](const httplib::Request&, httplib::Response& r) {
      const auto s = state.snapshot();
      if (!s.frame) return reply(r, {{"error", "no frame has been composited yet"}}, 503);
      const auto jpeg = codec::encode_jpeg(codec::to_display(*s.frame));
      if (!jpeg) return reply(r, {{"error", jpeg.error().detail}}, 500);
      r.set_content(std::string(jpeg->begin(), jpeg->end()), "image/jpeg");
    });
    server.set_error_handler([](const httplib::Request& q, httplib::Response& r) {
      if (!r.body.empty()) return;
      if (r.status == 404 && q.method != "GET" && q.method != "HEAD")
        reply(r, {{"error", "only GET is answered"}}, 405);
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
                                                const StageTimes& times, double stale_after_s) {
  auto impl = std::make_unique<Impl>();
  impl->guard();
  impl->routes(state, times, stale_after_s);
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
