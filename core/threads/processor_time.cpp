#include "core/threads/processor_time.h"

#include <pthread.h>

#include <array>
#include <charconv>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace penumbra {

namespace {

// Nothing of a thread that has ended.
std::optional<std::int64_t> clock_ns(clockid_t clock) {
  timespec now{};
  if (::clock_gettime(clock, &now) != 0) return {};
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

using SpentNs = std::array<std::int64_t, kProcessorUses>;

std::int64_t& of_use(SpentNs& spent, ProcessorUse use) {
  return spent[static_cast<std::size_t>(use)];
}

// Of one thread, which alone says what it is on; whoever asks counts it up to then.
class Spending {
 public:
  Spending();
  ~Spending();
  Spending(const Spending&) = delete;
  Spending& operator=(const Spending&) = delete;

  ProcessorUse on() const { return on_; }
  void switch_to(ProcessorUse use) {
    const std::scoped_lock lock(mutex_);
    count();
    on_ = use;
  }
  void add_to(SpentNs& all) {
    const std::scoped_lock lock(mutex_);
    count();
    for (std::size_t k = 0; k < all.size(); ++k) all[k] += spent_ns_[k];
  }

 private:
  // Up to now.
  void count() {
    const std::int64_t now = clock_ns(clock_).value_or(counted_ns_);
    of_use(spent_ns_, on_) += now - counted_ns_;
    counted_ns_ = now;
  }

  clockid_t clock_{};
  std::mutex mutex_;
  // Changed under mutex_; the thread itself reads on_ without it.
  ProcessorUse on_ = ProcessorUse::kOther;
  std::int64_t counted_ns_ = 0;  // of the thread's clock
  SpentNs spent_ns_{};
};

// All threads that have spent on anything, and what those spent that have ended. It outlives them.
struct Spenders {
  std::mutex mutex;
  std::vector<Spending*> threads;  // guarded by mutex, as is
  SpentNs ended_ns{};
};
Spenders& spenders() {
  static Spenders* const all = new Spenders;
  return *all;
}

Spending::Spending() {
  ::pthread_getcpuclockid(::pthread_self(), &clock_);
  const std::scoped_lock lock(spenders().mutex);
  spenders().threads.push_back(this);
}

Spending::~Spending() {
  const std::scoped_lock lock(spenders().mutex);
  add_to(spenders().ended_ns);
  std::erase(spenders().threads, this);
}

Spending& of_this_thread() {
  thread_local Spending spending;
  return spending;
}

SpentNs spent_so_far() {
  const std::scoped_lock lock(spenders().mutex);
  SpentNs out = spenders().ended_ns;
  for (Spending* thread : spenders().threads) thread->add_to(out);
  return out;
}

// The clock of a thread by its number, as the kernel composes it: all bits of the number inverted,
// then "of a thread" and "that it runs" (include/linux/posix-timers.h).
clockid_t clock_of_thread(int number) {
  return static_cast<clockid_t>(~static_cast<unsigned>(number) << 3 | 6u);
}

// Of threads that live, by proc(5); without it none.
std::int64_t ns_of_threads(std::string_view name_begins) {
  std::int64_t out = 0;
  std::error_code failed;
  for (std::filesystem::directory_iterator task("/proc/self/task", failed), end;
       !failed && task != end; task.increment(failed)) {
    std::string name;
    std::getline(std::ifstream(task->path() / "comm"), name);
    if (!name.starts_with(name_begins)) continue;
    const std::string digits = task->path().filename().string();
    int number = 0;
    std::from_chars(digits.data(), digits.data() + digits.size(), number);
    out += clock_ns(clock_of_thread(number)).value_or(0);
  }
  return out;
}

}  // namespace

void spend_on(ProcessorUse use) {
  Spending& thread = of_this_thread();
  if (thread.on() != use) thread.switch_to(use);
}

ProcessorUse spending_on() {
  return of_this_thread().on();
}

ProcessorTimes processor_times() {
  SpentNs spent = spent_so_far();
  const std::int64_t drawing = ns_of_threads("llvmpipe-"),
                     all = clock_ns(CLOCK_PROCESS_CPUTIME_ID).value_or(0);
  const std::int64_t cameras = of_use(spent, ProcessorUse::kCameras),
                     pipeline = of_use(spent, ProcessorUse::kPipeline),
                     encoding = of_use(spent, ProcessorUse::kEncoding);
  const auto ms = [](std::int64_t ns) { return 1e-6 * static_cast<double>(ns); };
  return {.pipeline_ms = ms(pipeline),
          .drawing_ms = ms(drawing),
          .cameras_ms = ms(cameras),
          .encoding_ms = ms(encoding),
          .other_ms = ms(all - pipeline - drawing - cameras - encoding)};
}

}  // namespace penumbra
