#include "core/io/log.h"

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <map>
#include <mutex>
#include <string>

namespace penumbra {

namespace {

void to_standard_error(LogLevel level, std::string_view line) {
  fmt::print(stderr, "{}: {}\n", level == LogLevel::kInfo ? "info" : "warning", line);
}

struct Log {
  std::mutex mutex;
  LogSink sink = to_standard_error;
};

Log& the_log() {
  static Log log;
  return log;
}

}  // namespace

namespace {

LogSink rate_limited(LogSink sink, double seconds) {
  using Clock = std::chrono::steady_clock;
  struct Said {
    Clock::time_point at;
    std::uint64_t held_back = 0;
  };
  constexpr std::size_t kMaxLines = 256;
  return [sink = std::move(sink), seconds, said = std::map<std::string, Said, std::less<>>()](
             LogLevel level, std::string_view line) mutable {
    const auto now = Clock::now();
    const auto before = said.find(line);
    if (before == said.end()) {
      if (said.size() >= kMaxLines) said.clear();
      said.emplace(line, Said{now});
      return sink(level, line);
    }
    Said& last = before->second;
    if (now - last.at < std::chrono::duration<double>(seconds)) return void(++last.held_back);
    const std::uint64_t held_back = std::exchange(last.held_back, 0);
    last.at = now;
    sink(level, held_back ? fmt::format("{} ({} times more)", line, held_back) : std::string(line));
  };
}

}  // namespace

void limit_log_rate(double seconds) {
  const std::scoped_lock lock(the_log().mutex);
  if (the_log().sink) the_log().sink = rate_limited(std::move(the_log().sink), seconds);
}

void set_log_sink(LogSink sink) {
  const std::scoped_lock lock(the_log().mutex);
  the_log().sink = std::move(sink);
}

void log(LogLevel level, std::string_view line) {
  const std::scoped_lock lock(the_log().mutex);
  if (the_log().sink) the_log().sink(level, line);
}

}  // namespace penumbra
