// Messages of a running library: what was left out, what takes long. The program decides where they
// go.
// threads: thread-safe
#pragma once

#include <fmt/format.h>

#include <functional>
#include <string_view>
#include <utility>

#pragma GCC visibility push(default)
namespace penumbra {

enum class LogLevel { kInfo, kWarning };

/// Gets a line without its end.
/// threads: any, one call at a time
using LogSink = std::function<void(LogLevel level, std::string_view line)>;

/// Where messages go from now on; an empty sink drops them. Until it is called: standard error.
void set_log_sink(LogSink sink);

/// From now on a line passes once in so many seconds, and says then how often it came in between.
void limit_log_rate(double seconds);

void log(LogLevel level, std::string_view line);

template <class... Args>
void log_info(fmt::format_string<Args...> format, Args&&... args) {
  log(LogLevel::kInfo, fmt::format(format, std::forward<Args>(args)...));
}
template <class... Args>
void log_warning(fmt::format_string<Args...> format, Args&&... args) {
  log(LogLevel::kWarning, fmt::format(format, std::forward<Args>(args)...));
}

}  // namespace penumbra
#pragma GCC visibility pop
