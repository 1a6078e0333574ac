#include "capture/poses/pose_stream.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <exception>
#include <utility>

#include "capture/poses/pose_line.h"
#include "core/exceptions.h"
#include "core/io/log.h"

namespace penumbra::capture {

namespace {

namespace fs = std::filesystem;

std::unexpected<Error> cannot(const std::string& where, int error) {
  return fail(ErrorCode::kUnavailable, where, std::strerror(error));
}

TimestampNs monotonic_now() {
  return {std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count()};
}

Result<UniqueFd> bind_udp(int port, const std::string& name, int& bound) {
  UniqueFd socket(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket) return cannot(name, errno);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  auto* const raw = reinterpret_cast<sockaddr*>(&address);
  if (::bind(socket.get(), raw, size) != 0 || ::getsockname(socket.get(), raw, &size) != 0)
    return cannot(name, errno);
  bound = ntohs(address.sin_port);
  return socket;
}

// Whether somebody reads from a socket's name.
bool somebody_reads(const sockaddr_un& name) {
  const UniqueFd probe(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  return probe &&
         ::connect(probe.get(), reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0;
}

Result<UniqueFd> bind_unix(const fs::path& path) {
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  if (path.native().size() >= sizeof name.sun_path)
    return fail(
        ErrorCode::kInvalid, path.string(),
        fmt::format("is longer than the {} bytes of a socket's name", sizeof name.sun_path - 1));
  std::ranges::copy(path.native(), name.sun_path);
  if (somebody_reads(name))
    return fail(ErrorCode::kUnavailable, path.string(), "is another program's socket");
  std::error_code error;
  if (fs::is_socket(path, error)) fs::remove(path, error);  // of one that was killed
  UniqueFd socket(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket || ::bind(socket.get(), reinterpret_cast<const sockaddr*>(&name), sizeof name) != 0)
    return cannot(path.string(), errno);
  return socket;
}

Result<void> check_stream(const PoseStreamOptions& o) {
  constexpr double kLargestOffset_s = 1e9;
  const auto invalid = [](const char* key, const char* why) {
    return fail(ErrorCode::kInvalid, key, why);
  };
  if (o.socket.empty() == !o.port.has_value())
    return invalid("stream of poses", "needs either a socket or a port");
  if (o.port && (*o.port < 0 || *o.port > 65535)) return invalid("port", "is not within 0..65535");
  if (!(std::abs(o.clock_offset.count()) <= kLargestOffset_s))
    return invalid("clock_offset_s", "is not within a billion seconds");
  return {};
}

}  // namespace

PoseStream::PoseStream(const PoseStreamOptions& options, std::string name)
    : options_(options),
      name_(std::move(name)),
      history_({.name = name_, .max_extrapolation = options.max_extrapolation}) {}

Result<std::unique_ptr<PoseStream>> PoseStream::open(const PoseStreamOptions& options) {
  PENUMBRA_TRY(check_stream(options));
  const std::string name = options.port ? fmt::format("poses on 127.0.0.1:{}", *options.port)
                                        : fmt::format("poses on {}", options.socket.string());
  std::unique_ptr<PoseStream> out(new PoseStream(options, name));
  auto socket =
      options.port ? bind_udp(*options.port, name, out->port_) : bind_unix(options.socket);
  if (!socket) return std::unexpected(std::move(socket).error());
  out->socket_ = std::move(*socket);
  out->made_file_ = !options.port;
  out->wake_ = UniqueFd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!out->wake_) return cannot(name, errno);
  try {
    out->thread_ = std::jthread([stream = out.get()](const std::stop_token& s) { stream->run(s); });
  } catch (const std::system_error& e) {
    return fail(ErrorCode::kUnavailable, name, reason_of(e));
  }
  return out;
}

PoseStream::~PoseStream() {
  if (thread_.joinable()) {
    thread_.request_stop();
    const std::uint64_t one = 1;
    [[maybe_unused]] const auto woken = ::write(wake_.get(), &one, sizeof one);
    thread_.join();
  }
  std::error_code ignored;
  if (made_file_) fs::remove(options_.socket, ignored);
}

void PoseStream::run(const std::stop_token& stop) noexcept {
  try {
    std::array<char, kLargestPoseLine + 1> buffer;  // one more tells a line that is too long
    while (!stop.stop_requested()) {
      pollfd waiting[] = {{socket_.get(), POLLIN, 0}, {wake_.get(), POLLIN, 0}};
      if (::poll(waiting, 2, -1) < 0 && errno != EINTR) break;
      for (ssize_t got = 0; !stop.stop_requested();) {
        got = ::recv(socket_.get(), buffer.data(), buffer.size(), 0);
        if (got < 0) break;
        take({buffer.data(), static_cast<std::size_t>(got)}, monotonic_now());
      }
    }
    if (!stop.stop_requested()) log_warning("{}: {}", name_, std::strerror(errno));
  } catch (const std::exception& e) {
    log_warning("{}: ended: {}", name_, reason_of(e));
  }
}

void PoseStream::take(std::string_view datagram, TimestampNs arrival) {
  auto pose = parse_pose_line(datagram);
  std::optional<Error> first;
  {
    const std::scoped_lock lock(mutex_);
    Result<void> taken;
    if (pose) {
      pose->time = options_.by_arrival ? arrival : pose->time + options_.clock_offset;
      taken = history_.put(*pose);
    } else {
      ++unread_;
      taken = std::unexpected(pose.error());
    }
    if (!taken && !std::exchange(said_, true)) first = taken.error();
  }
  if (first) log_warning("{}: {}: such datagrams are left out and counted", name_, first->detail);
}

std::optional<FramePose> PoseStream::pose_of(const Frame& frame) {
  const std::scoped_lock lock(mutex_);
  asked_ = frame.time;
  return history_.at(frame.time);
}

PoseSourceState PoseStream::state() const {
  const std::scoped_lock lock(mutex_);
  PoseSourceState out{name_, {}, history_.taken(), history_.refused() + unread_, {}};
  const auto newest = history_.newest();
  if (newest && asked_) out.age = std::max(Seconds(0), *asked_ - *newest);
  if (!newest)
    out.trouble = "no pose has arrived";
  else if (asked_ && !history_.at(*asked_))
    out.trouble = "no pose at the time of the last frame: is the sender running, on this clock?";
  return out;
}

}  // namespace penumbra::capture
