#include "core/threads/processor_time.h"

#include <unistd.h>

#include <array>
#include <atomic>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace penumbra {

namespace {

std::array<std::atomic<std::int64_t>, 3> spent_ns;  // by use; what is other is not counted

struct Spending {
  ProcessorUse on = ProcessorUse::kOther;
  std::int64_t counted_ns = 0;  // of the thread's clock
};
thread_local Spending spending;

std::int64_t clock_ns(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

void count_until_now() {
  const std::int64_t now = clock_ns(CLOCK_THREAD_CPUTIME_ID);
  if (spending.on != ProcessorUse::kOther)
    spent_ns[static_cast<std::size_t>(spending.on)] += now - spending.counted_ns;
  spending.counted_ns = now;
}

void switch_to(ProcessorUse use) {
  if (spending.on == use) return;
  count_until_now();
  spending.on = use;
}

double spent_ms(ProcessorUse use) {
  return 1e-6 * static_cast<double>(spent_ns[static_cast<std::size_t>(use)]);
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

SpendingOn::SpendingOn(ProcessorUse use) : before_(spending.on) {
  switch_to(use);
}
SpendingOn::~SpendingOn() {
  switch_to(before_);
}

ProcessorUse spending_on() {
  return spending.on;
}

ProcessorTimes processor_times() {
  count_until_now();
  ProcessorTimes out{.pipeline_ms = spent_ms(ProcessorUse::kPipeline),
                     .drawing_ms = ms_of_threads("llvmpipe-"),
                     .cameras_ms = spent_ms(ProcessorUse::kCameras)};
  out.other_ms = 1e-6 * static_cast<double>(clock_ns(CLOCK_PROCESS_CPUTIME_ID)) - out.pipeline_ms -
                 out.drawing_ms - out.cameras_ms;
  return out;
}

}  // namespace penumbra
