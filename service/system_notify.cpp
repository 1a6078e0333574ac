#include "service/system_notify.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace penumbra::service {

void notify_system(const std::string& state) {
  const char* const path = std::getenv("NOTIFY_SOCKET");
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  if (!path || std::strlen(path) < 2 || std::strlen(path) >= sizeof name.sun_path) return;
  std::memcpy(name.sun_path, path, std::strlen(path));   // and the zeros that are there
  if (name.sun_path[0] == '@') name.sun_path[0] = '\0';  // an abstract one
  const int socket = ::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (socket < 0) return;
  const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + std::strlen(path));
  (void)::sendto(socket, state.data(), state.size(), MSG_NOSIGNAL,
                 reinterpret_cast<const sockaddr*>(&name), size);
  ::close(socket);
}

Watchdog::Watchdog(std::function<bool()> is_alive) {
  const char* const text = std::getenv("WATCHDOG_USEC");
  const double period_us = text ? std::atof(text) : 0;
  if (!(period_us > 0)) return;
  thread_ = std::jthread([this, period_us, is_alive = std::move(is_alive)] {
    using Clock = std::chrono::steady_clock;
    const auto half = std::chrono::duration_cast<Clock::duration>(
        std::chrono::duration<double, std::micro>(period_us / 2));
    auto due = Clock::now();
    while (!ends_) {
      if (Clock::now() >= due) {
        if (is_alive()) notify_system("WATCHDOG=1");
        due += half;
      }
      std::this_thread::sleep_for(std::min<Clock::duration>(half, std::chrono::milliseconds(50)));
    }
  });
}

Watchdog::~Watchdog() {
  ends_ = true;
}

}  // namespace penumbra::service
