#include "core/io/log.h"

#include <cstdio>
#include <mutex>

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

void set_log_sink(LogSink sink) {
  const std::scoped_lock lock(the_log().mutex);
  the_log().sink = std::move(sink);
}

void log(LogLevel level, std::string_view line) {
  const std::scoped_lock lock(the_log().mutex);
  if (the_log().sink) the_log().sink(level, line);
}

}  // namespace penumbra
