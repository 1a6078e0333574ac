#include "core/threads/processor_time.h"

#include <pthread.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

namespace penumbra {

namespace {

std::array<std::atomic<std::int64_t>, 3> spent_ns;  // by use; what is other is not counted

std::int64_t clock_ns(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

std::atomic<std::int64_t>& spent(ProcessorUse use) {
  return spent_ns[static_cast<std::size_t>(use)];
}

// Of one thread, which alone writes it.
struct Spending {
  std::atomic<ProcessorUse> on = ProcessorUse::kOther;
  std::atomic<std::int64_t> counted_ns = 0;  // of the thread's clock
  clockid_t clock{};

  Spending();
  ~Spending();
  Spending(const Spending&) = delete;
  Spending& operator=(const Spending&) = delete;
};

// All threads that have spent on anything. It outlives them.
struct Spenders {
  std::mutex mutex;
  std::vector<const Spending*> threads;  // guarded by mutex
};
Spenders& spenders() {
  static Spenders* const all = new Spenders;
  return *all;
}

Spending::Spending() {
  ::pthread_getcpuclockid(::pthread_self(), &clock);
  const std::scoped_lock lock(spenders().mutex);
  spenders().threads.push_back(this);
}

Spending::~Spending() {
  const std::scoped_lock lock(spenders().mutex);
  spent(on) += clock_ns(clock) - counted_ns;
  std::erase(spenders().threads, this);
}

Spending& of_this_thread() {
  thread_local Spending spending;
  return spending;
}

double spent_ms(ProcessorUse use) {
  std::int64_t ns = spent(use);
  for (const Spending* thread : spenders().threads)
    if (thread->on == use) ns += clock_ns(thread->clock) - thread->counted_ns;
  return 1e-6 * static_cast<double>(ns);
}

// User and system time of threads that live, proc(5): behind a name in brackets that may hold any
// character.
double ms_of_threads(std::string_view name_begins) {
  const double tick_ms = 1e3 / static_cast<double>(::sysconf(_SC_CLK_TCK));
  constexpr int kUserTime = 14 - 3;  // the field after the name is the third
  double out = 0;
  std::error_code failed;
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task", failed)) {
    std::string line;
    std::getline(std::ifstream(task.path() / "stat"), line);
    const std::size_t begin = line.find('('), end = line.rfind(')');
    if (begin == std::string::npos || end == std::string::npos) continue;  // it has ended
    if (!std::string_view(line).substr(begin + 1).starts_with(name_begins)) continue;
    std::istringstream fields(line.substr(end + 1));
    std::string skipped;
    double user = 0, system = 0;
    for (int i = 0; i < kUserTime; ++i) fields >> skipped;
    if (fields >> user >> system) out += tick_ms * (user + system);
  }
  return out;
}

}  // namespace

void spend_on(ProcessorUse use) {
  Spending& thread = of_this_thread();
  if (thread.on == use) return;
  const std::int64_t now = clock_ns(thread.clock);
  spent(thread.on) += now - thread.counted_ns;
  thread.counted_ns = now;
  thread.on = use;
}

ProcessorUse spending_on() {
  return of_this_thread().on;
}

ProcessorTimes processor_times() {
  const std::scoped_lock lock(spenders().mutex);
  ProcessorTimes out{.pipeline_ms = spent_ms(ProcessorUse::kPipeline),
                     .drawing_ms = ms_of_threads("llvmpipe-"),
                     .cameras_ms = spent_ms(ProcessorUse::kCameras)};
  out.other_ms = 1e-6 * static_cast<double>(clock_ns(CLOCK_PROCESS_CPUTIME_ID)) - out.pipeline_ms -
                 out.drawing_ms - out.cameras_ms;
  return out;
}

}  // namespace penumbra
