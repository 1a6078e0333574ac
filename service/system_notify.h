// What systemd is told of a service of Type=notify, see sd_notify(3). Nothing where it does not
// listen.
// threads: thread-safe
#pragma once

#include <atomic>
#include <functional>
#include <string>
#include <thread>

namespace penumbra::service {

/// state: "READY=1", "STATUS=...", "STOPPING=1", "RELOADING=1", "WATCHDOG=1"; several by line ends
void notify_system(const std::string& state);

/// Tells the watchdog twice in its time that the service lives, as long as that is true.
class Watchdog {
 public:
  /// is_alive: called on a thread of its own
  explicit Watchdog(std::function<bool()> is_alive);
  ~Watchdog();

 private:
  std::atomic<bool> ends_ = false;
  std::jthread thread_;
};

}  // namespace penumbra::service
