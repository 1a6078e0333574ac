#include "core/threads/stop_signal.h"

#include <csignal>

namespace penumbra {

namespace {

std::atomic<bool> g_stop = false;  // set by the signal handler alone
static_assert(std::atomic<bool>::is_always_lock_free);

extern "C" void on_signal(int signal) {
  g_stop = true;
  std::signal(signal, SIG_DFL);
}

}  // namespace

const std::atomic<bool>& catch_stop_signals() {
  g_stop = false;
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  return g_stop;
}

}  // namespace penumbra
