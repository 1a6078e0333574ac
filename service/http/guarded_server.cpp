#include "service/http/internal/guarded_server.h"

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

#include "core/io/log.h"

namespace penumbra::service {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

namespace {

// What the library passes over, and what two programs may understand differently: lines without a
// colon, lines that go on the one before, zero bytes.
class HeadCheck {
 public:
  void add(std::string_view bytes) {
    for (const char c : bytes) {
      if (ended_) return;
      if (c == '\0') malformed_ = true;
      if (c == '\n')
        end_line();
      else if (c != '\r')
        goes_on_ |= length_ == 0 && (c == ' ' || c == '\t'), has_colon_ |= c == ':', ++length_;
    }
  }
  bool is_malformed() const { return malformed_; }

 private:
  void end_line() {
    if (!first_ && length_ == 0) ended_ = true;
    if (!first_ && length_ > 0 && (!has_colon_ || goes_on_)) malformed_ = true;
    first_ = goes_on_ = has_colon_ = false;
    length_ = 0;
  }
  bool first_ = true, ended_ = false, malformed_ = false, goes_on_ = false, has_colon_ = false;
  std::size_t length_ = 0;  // of the line
};

// A request that must not be answered as what the library made of it.
struct BadRequest : std::runtime_error {
  explicit BadRequest(const char* reason, const char* status = "400 Bad Request")
      : std::runtime_error(reason), status(status) {}
  const char* status;
};

// Of the head that the library has read.
std::size_t body_length(const httplib::Request& q) {
  if (q.get_header_value_count("Content-Length") > 1)
    throw BadRequest("the request has more than one Content-Length");
  const std::string text = q.get_header_value("Content-Length");
  std::size_t length = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), length);
  if (!text.empty() && (error != std::errc() || end != text.data() + text.size()))
    throw BadRequest("Content-Length is no number of bytes");
  return length;
}

}  // namespace

// In slices, so that a stop is not waited for.
class GuardedServer::Client final : public httplib::Stream {
 public:
  static constexpr auto kPatience = 5s, kShortPatience = 1s;  // the latter where clients are many
  static constexpr auto kAtAStop = 200ms;

  Client(socket_t socket, const GuardedServer& server) : socket_(socket), server_(server) {}

  /// Until bytes of a next request are there. False: none come.
  bool await_request(std::chrono::seconds idle) {
    request_bytes_ = 0;
    head_ = {};
    const bool comes =
        next_ < filled_ || wait(POLLIN, Clock::now() + (is_crowded() ? kShortPatience : idle));
    closes_ = false;
    deadline_ = Clock::now() + (is_crowded() ? kShortPatience : kPatience);
    return comes;
  }
  /// Its head has been read, and says that so many bytes follow.
  void expect_body(std::size_t bytes) { body_ends_ = request_bytes_ + bytes; }
  bool has_read_body() const { return request_bytes_ == body_ends_; }
  /// Whether the answer has said that nothing follows it.
  bool closes() const { return closes_; }
  bool has_malformed_head() const { return head_.is_malformed(); }

  bool is_readable() const override { return next_ < filled_ || ready(POLLIN, 0ms); }
  bool is_writable() const override {
    std::byte byte{};
    const bool open = ::recv(socket_, &byte, 1, MSG_PEEK | MSG_DONTWAIT) != 0;
    return open && wait(POLLOUT, Clock::now() + kPatience);
  }
  ssize_t read(char* to, std::size_t size) override {
    if (next_ == filled_ && !fill()) return -1;
    const std::size_t n = std::min(
        {size, filled_ - next_, kMaxRequest_bytes - std::min(request_bytes_, kMaxRequest_bytes)});
    if (n == 0) return -1;
    std::memcpy(to, buffer_.data() + next_, n);
    head_.add({to, n});
    next_ += n, request_bytes_ += n;
    return static_cast<ssize_t>(n);
  }
  // Also to a client that has said that it sends no more, and waits for the answer.
  ssize_t write(const char* from, std::size_t size) override {
    // The head comes as one, after a "100 Continue" where that was asked for.
    const std::string_view text(from, size);
    if (text.starts_with("HTTP/1.1 "))
      closes_ = text.find("\r\nConnection: close\r\n") != std::string_view::npos;
    while (wait(POLLOUT, Clock::now() + kPatience)) {
      const ssize_t n = ::send(socket_, from, size, MSG_NOSIGNAL | MSG_DONTWAIT);
      if (n >= 0 || (errno != EAGAIN && errno != EINTR)) return n;
    }
    return -1;
  }
  void get_remote_ip_and_port(std::string&, int&) const override {}
  void get_local_ip_and_port(std::string&, int&) const override {}
  socket_t socket() const override { return socket_; }

  /// What was sent arrives only where nothing that the client sent is left unread.
  void close() {
    ::shutdown(socket_, SHUT_WR);
    const auto until = Clock::now() + 200ms;
    std::size_t left = 1 << 20;
    while (left > 0 && wait(POLLIN, until)) {
      const ssize_t n = ::recv(socket_, buffer_.data(), buffer_.size(), MSG_DONTWAIT);
      if (n <= 0) break;
      left -= std::min(left, static_cast<std::size_t>(n));
    }
    ::close(socket_);
  }

 private:
  bool is_crowded() const { return server_.clients_ > kMaxClients / 2; }
  bool ready(short events, std::chrono::milliseconds timeout) const {
    pollfd p{socket_, events, 0};
    return ::poll(&p, 1, static_cast<int>(timeout.count())) > 0;
  }
  bool wait(short events, Clock::time_point until) const {
    constexpr auto kSlice = 50ms;
    do {
      if (ready(events, kSlice)) return true;
      if (server_.stopping_) return false;
    } while (Clock::now() < until);
    return false;
  }
  bool fill() {
    if (server_.stopping_ && !std::exchange(ends_, true))
      deadline_ = std::min(deadline_, Clock::now() + kAtAStop);
    if (Clock::now() > deadline_ || !wait(POLLIN, deadline_)) return false;
    const ssize_t n = ::recv(socket_, buffer_.data(), buffer_.size(), 0);
    next_ = 0, filled_ = n > 0 ? static_cast<std::size_t>(n) : 0;
    return n > 0;
  }

  const socket_t socket_;
  const GuardedServer& server_;
  std::array<char, 4096> buffer_{};
  std::size_t next_ = 0, filled_ = 0;  // in the buffer
  std::size_t request_bytes_ = 0, body_ends_ = 0;
  bool closes_ = false;
  HeadCheck head_;
  Clock::time_point deadline_;
  bool ends_ = false;
};

void GuardedServer::widen_queue() const {
  constexpr int kWaiting = 128;
  (void)::listen(svr_sock_, kWaiting);
}

void GuardedServer::serve(Client& client) {
  for (std::size_t left = keep_alive_max_count_; left > 0; --left) {
    if (!client.await_request(std::chrono::seconds(keep_alive_timeout_sec_))) return;
    bool closed = false, has_head = false, is_plain = false;
    const auto note_body = [&](const httplib::Request& q) {
      has_head = true;
      is_plain = !q.has_header("Transfer-Encoding");
      const std::size_t length = body_length(q);
      if (length > payload_max_length_)
        throw BadRequest("the request has a body of more than 64 KiB", "413 Content Too Large");
      client.expect_body(length);
      if (client.has_malformed_head()) throw BadRequest("the request has a line that is no header");
    };
    const bool served = process_request(client, left == 1, closed, note_body);
    if (!served || closed || !has_head || !is_plain || !client.has_read_body() || client.closes())
      return;
  }
}

// The library's loop knows neither of these bounds.
bool GuardedServer::process_and_close_socket(socket_t socket) {
  ++clients_;
  Client client(socket, *this);
  try {
    serve(client);
  } catch (const BadRequest& e) {
    const std::string body = std::string(R"({"error":")") + e.what() + "\"}\n",
                      answer = std::string("HTTP/1.1 ") + e.status +
                               "\r\nContent-Type: application/json\r\n"
                               "Connection: close\r\nContent-Length: " +
                               std::to_string(body.size()) + "\r\n\r\n" + body;
    client.write(answer.data(), answer.size());
  } catch (const std::exception& e) {  // no request ends the service
    log_warning("http: a connection is closed: {}", e.what());
  }
  client.close();
  --clients_;
  return true;
}

}  // namespace penumbra::service
