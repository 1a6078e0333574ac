#include "service/http/http_api.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <httplib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <csignal>
#include <thread>

#include "core/io/log.h"
#include "runtime/pipeline/report.h"
#include "service/http/internal/context.h"
#include "service/http/internal/guarded_server.h"
#include "service/http/internal/workers.h"
#include "service/http/loopback.h"

namespace penumbra::service {

namespace fs = std::filesystem;
using httplib::Request;
using httplib::Response;

nlohmann::json RecentStages::now() {
  const std::scoped_lock lock(mutex_);
  const auto at = std::chrono::steady_clock::now();
  if (stages_.is_null() || at - made_ > std::chrono::seconds(1)) {
    stages_ = runtime::to_json(times_);
    made_ = at;
  }
  return stages_;
}

std::string lower(std::string text) {
  std::ranges::transform(text, text.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

void reply(Response& response, const nlohmann::json& body, int status) {
  response.status = status;
  response.set_content(body.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n",
                       "application/json");
}

void refuse(Response& response, const Error& error) {
  const int status = error.code == ErrorCode::kNotFound      ? 404
                     : error.code == ErrorCode::kUnavailable ? 503
                     : error.code == ErrorCode::kUnwritable  ? 507
                                                             : 400;
  reply(response, {{"error", error.where + " " + error.detail}}, status);
}

namespace {

// Against DNS rebinding: a page whose name was bound anew to a loopback address sends that name.
bool is_for_loopback(const Request& request) {
  const std::string host = lower(request.get_header_value("Host"));
  const bool is_v6 = host.starts_with('[');
  const std::size_t end = std::min(host.size(), host.find(is_v6 ? ']' : ':'));
  const std::string port = host.substr(std::min(host.size(), end + (is_v6 ? 1 : 0)));
  const auto is_digit = [](unsigned char c) { return std::isdigit(c) != 0; };
  if (!port.empty() && (port[0] != ':' || !std::all_of(port.begin() + 1, port.end(), is_digit)))
    return false;
  return is_loopback(is_v6 ? host.substr(1, end - 1) : host.substr(0, end));
}

// In a time that tells nothing about where they differ.
bool are_same(const std::string& a, const std::string& b) {
  if (a.size() != b.size()) return false;
  unsigned char differ = 0;
  for (std::size_t i = 0; i < a.size(); ++i) differ |= static_cast<unsigned char>(a[i] ^ b[i]);
  return differ == 0;
}

// Whether a cookie of the name has the value; others of that name may be there, of other paths.
bool has_cookie(const std::string& cookies, const std::string& name, const std::string& value) {
  for (std::size_t from = 0; from < cookies.size();) {
    from = std::min(cookies.size(), cookies.find_first_not_of("; \t", from));
    const std::size_t end = std::min(cookies.size(), cookies.find(';', from));
    const std::string one = cookies.substr(from, end - from);
    if (one.starts_with(name + "=") && are_same(one.substr(name.size() + 1), value)) return true;
    from = end;
  }
  return false;
}

// As a bearer, or once in the address, which the page's own requests then carry as a cookie.
// cookie: its name, another one for each port, as browsers keep those of a host together
bool has_token(const Request& q, const std::string& token, const std::string& cookie, Response& r) {
  constexpr std::size_t kBearer = 7;  // its name is of any case
  const std::string bearer = q.get_header_value("Authorization");
  if (lower(bearer.substr(0, kBearer)) == "bearer " && are_same(bearer.substr(kBearer), token))
    return true;
  if (q.has_param("token") && are_same(q.get_param_value("token"), token)) {
    r.set_header("Set-Cookie", cookie + "=" + token + "; HttpOnly; SameSite=Strict; Path=/");
    return true;
  }
  return has_cookie(q.get_header_value("Cookie"), cookie, token);
}

// The library's own options let a second server share the port and take half of the requests.
void let_address_be_reused(socket_t socket) {
  const int yes = 1;
  ::setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
}

// Whether somebody listens on a socket's name.
bool is_listened_on(const sockaddr_un& name) {
  const int probe = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (probe < 0) return false;
  const bool yes = ::connect(probe, reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0;
  ::close(probe);
  return yes;
}

// Makes its folder and takes away what a service that was killed has left.
Result<void> clear_socket(const fs::path& path) {
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  if (path.native().size() >= sizeof name.sun_path)
    return fail(
        ErrorCode::kInvalid, path.string(),
        fmt::format("is longer than the {} bytes of a socket's name", sizeof name.sun_path - 1));
  std::ranges::copy(path.native(), name.sun_path);
  std::error_code error;
  if (!path.parent_path().empty()) fs::create_directories(path.parent_path(), error);
  if (error) return fail(ErrorCode::kUnavailable, path.parent_path().string(), error.message());
  if (is_listened_on(name))
    return fail(ErrorCode::kUnavailable, path.string(), "is another service's socket");
  if (fs::is_socket(path, error)) fs::remove(path, error);
  return {};
}

}  // namespace

struct HttpApi::Impl {
  static constexpr int kIdle_s = 5;  // pages ask once a second

  HttpContext context;
  GuardedServer over_tcp, over_socket;
  std::jthread tcp_thread, socket_thread;
  fs::path socket;
  int port = 0;

  Impl(const HttpOptions& options, const HttpSources& sources) : context(options, sources) {}

  void set_limits(httplib::Server& server) {
    server.set_tcp_nodelay(true);
    server.set_payload_max_length(1 << 16);
    server.set_keep_alive_timeout(kIdle_s);
    server.set_keep_alive_max_count(10'000);
    server.new_task_queue = [] { return new Workers(GuardedServer::kMaxClients); };
    server.set_exception_handler([](const Request&, Response& r, const std::exception_ptr&) {
      reply(r, {{"error", "the request could not be answered"}}, 500);
    });
  }

  // True where the request is refused, and answered.
  bool is_refused(const Request& q, Response& r, bool tcp) const {
    const HttpOptions& o = context.options;
    const bool has_body = q.method == "POST" || q.method == "PUT" || q.method == "PATCH";
    // In parts it could be of any length.
    if (q.has_header("Transfer-Encoding") || (has_body && !q.has_header("Content-Length"))) {
      reply(r, {{"error", "the request does not say how long its body is"}}, 411);
      return true;
    }
    if (q.get_header_value_count("Host") > 1) {
      reply(r, {{"error", "the request has more than one Host"}}, 400);
      return true;
    }
    if (!tcp) return false;  // who may open the socket may ask
    if (o.token.empty() && !is_for_loopback(q)) {
      reply(r, {{"error", "only requests to localhost or a loopback address are answered"}}, 403);
      return true;
    }
    const std::string cookie = fmt::format("penumbra_token_{}", port);
    if (!o.token.empty() && q.method != "OPTIONS" && !has_token(q, o.token, cookie, r)) {
      r.set_header("WWW-Authenticate", "Bearer");
      reply(r, {{"error", "the token is missing or wrong"}}, 401);
      return true;
    }
    return false;
  }

  // Pages of listed origins may read the answer, others may not even show it.
  void tell_origin(const Request& q, Response& r) const {
    const std::string origin = q.get_header_value("Origin");
    const bool listed =
        std::ranges::find(context.options.origins, origin) != context.options.origins.end();
    r.set_header("Vary", "Origin");
    r.set_header("Cross-Origin-Resource-Policy", listed ? "cross-origin" : "same-origin");
    if (!listed) return;
    r.set_header("Access-Control-Allow-Origin", origin);
    r.set_header("Access-Control-Expose-Headers", "Penumbra-Time-Ns");
    if (q.method != "OPTIONS") return;
    r.set_header("Access-Control-Allow-Methods", "GET, PATCH, POST, PUT, DELETE");
    r.set_header("Access-Control-Allow-Headers", "Content-Type, Authorization");
    r.set_header("Access-Control-Max-Age", "600");
  }

  void set_up(httplib::Server& server, bool tcp) {
    set_limits(server);
    server.set_pre_routing_handler([this, tcp](const Request& q, Response& r) {
      using Handled = httplib::Server::HandlerResponse;
      // Parts of what changes with each request make no sense: all of it is answered.
      const_cast<Request&>(q).ranges.clear();
      tell_origin(q, r);
      if (is_refused(q, r, tcp)) {
        r.set_header("Connection", "close");  // its body is left unread
        return Handled::Handled;
      }
      if (q.method != "OPTIONS") return Handled::Unhandled;
      r.status = 204;
      return Handled::Handled;
    });
    add_read_routes(server, context);
    add_change_routes(server, context);
    add_stream_routes(server, context);
    add_page_routes(server);
    set_errors(server);
  }

  static void set_errors(httplib::Server& server) {
    server.set_error_handler([](const Request& q, Response& r) {
      if (!r.body.empty()) return;
      const std::string shown = q.path.substr(0, 200);
      const std::string allowed = r.status == 404 ? allowed_methods(q.path) : "";
      if (!allowed.empty() && allowed.find(q.method) == std::string::npos) {
        r.set_header("Allow", allowed);
        reply(r, {{"error", fmt::format("{} is not answered at {}", q.method, shown)}}, 405);
      } else if (r.status == 404) {
        reply(r, {{"error", fmt::format("nothing at {}", shown)}}, 404);
      } else {
        r.set_header("Connection", "close");  // what is left of the request is not read
        reply(
            r,
            {{"error", r.status == 413   ? "the request is too large"
                       : r.status == 414 ? "the address is longer than 8192 bytes"
                       : r.status == 416 ? "the range makes no sense"
                                         : "the request is not valid, or did not come as a whole"}},
            r.status);
      }
    });
  }

  // A service that nobody can ask is better begun anew.
  void listen(GuardedServer& server) const {
    server.widen_queue();
    (void)server.listen_after_bind();
    if (context.stopping) return;
    log_warning("http: the system takes no more connections: the service ends");
    std::raise(SIGTERM);
  }

  Result<void> listen_on_tcp() {
    const HttpOptions& o = context.options;
    if (!is_loopback(o.address) && o.token.empty())
      return fail(ErrorCode::kInvalid, o.address, "is not a loopback address: others need a token");
    over_tcp.set_socket_options(let_address_be_reused);
    set_up(over_tcp, true);
    port = *o.port == 0 ? over_tcp.bind_to_any_port(o.address) : *o.port;
    if (*o.port == 0 ? port <= 0 : !over_tcp.bind_to_port(o.address, port))
      return fail(ErrorCode::kUnavailable, fmt::format("{}:{}", o.address, *o.port),
                  "cannot be listened on: is it in use?");
    tcp_thread = std::jthread([this] { listen(over_tcp); });
    return {};
  }

  Result<void> listen_on_socket() {
    PENUMBRA_TRY(clear_socket(context.options.socket));
    over_socket.set_address_family(AF_UNIX);
    over_socket.set_socket_options([](socket_t) {});
    set_up(over_socket, false);
    const mode_t before = ::umask(context.options.socket_for_group ? 0117 : 0177);
    const bool bound = over_socket.bind_to_port(context.options.socket.string(), 80);
    ::umask(before);
    if (!bound)
      return fail(ErrorCode::kUnavailable, context.options.socket.string(),
                  "cannot be made a socket");
    socket = context.options.socket;
    socket_thread = std::jthread([this] { listen(over_socket); });
    return {};
  }

  // A stop before a server runs would be lost, and the destructor would wait for ever.
  static void wait_for(const httplib::Server& server) {
    for (int i = 0; i < 5000 && !server.is_running(); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }

  ~Impl() {
    context.stopping = true;
    over_tcp.stop_waiting(), over_socket.stop_waiting();
    if (tcp_thread.joinable()) wait_for(over_tcp), over_tcp.stop();
    if (socket_thread.joinable()) wait_for(over_socket), over_socket.stop();
    std::error_code ignored;
    if (!socket.empty()) fs::remove(socket, ignored);
  }
};

HttpApi::HttpApi(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
HttpApi::~HttpApi() = default;
int HttpApi::port() const {
  return impl_->port;
}
const fs::path& HttpApi::socket() const {
  return impl_->socket;
}

Result<std::unique_ptr<HttpApi>> HttpApi::start(const HttpOptions& options,
                                                const HttpSources& sources) {
  auto impl = std::make_unique<Impl>(options, sources);
  if (options.port) PENUMBRA_TRY(impl->listen_on_tcp());
  if (!options.socket.empty()) PENUMBRA_TRY(impl->listen_on_socket());
  return std::unique_ptr<HttpApi>(new HttpApi(std::move(impl)));
}

}  // namespace penumbra::service
