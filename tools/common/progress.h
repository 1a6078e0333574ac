// Progress of long work on standard error: a bar, or a line now and then where that is not a
// terminal.
#pragma once

#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <functional>
#include <string>

namespace penumbra::tools {

/// A line every ten seconds, for logs.
inline std::function<void(double)> progress_lines(const std::string& what) {
  using Clock = std::chrono::steady_clock;
  return [what, first = -1., start = Clock::now(), told = Clock::now()](double done) mutable {
    if (first < 0 || done < first) first = done, start = Clock::now();
    if (done >= 1 || Clock::now() - told < std::chrono::seconds(10)) return;
    told = Clock::now();
    const double since = std::chrono::duration<double>(told - start).count();
    const long left = done > first ? std::lround(since * (1 - done) / (done - first)) : 0;
    std::fprintf(stderr, "%s: %d %%, %ld:%02ld left\n", what.c_str(), static_cast<int>(done * 100),
                 left / 60, left % 60);
  };
}

/// Done: 0..1; falling back begins another round, with a bar of its own.
inline std::function<void(double)> progress_bar(const std::string& what) {
  if (!isatty(STDERR_FILENO)) return progress_lines(what);
  using Clock = std::chrono::steady_clock;
  return [what, last = -1, first = -1., start = Clock::now()](double done) mutable {
    const int percent = static_cast<int>(done * 100);
    if (percent == last) return;
    if (percent < last) start = Clock::now(), first = done;  // another round
    last = percent;
    // Work that goes on where it stopped begins further on: only what was done since then tells the
    // pace.
    if (first < 0) first = done;
    const double since = std::chrono::duration<double>(Clock::now() - start).count();
    const long left = done > first ? std::lround(since * (1 - done) / (done - first)) : 0;
    const std::string bar(static_cast<std::size_t>(percent * 30 / 100), '#');
    std::fprintf(stderr, "\r%-24.24s [%-30s] %3d %%", what.c_str(), bar.c_str(), percent);
    if (percent < 100 && left > 0) {
      std::fprintf(stderr, "  %ld:%02ld left ", left / 60, left % 60);
    } else {
      std::fprintf(stderr, "%14s%s", "", percent >= 100 ? "\n" : "");
    }
    std::fflush(stderr);
  };
}

/// For work whose end is not known: a count.
inline std::function<void(std::size_t)> progress_count(const std::string& what) {
  if (!isatty(STDERR_FILENO)) return [](std::size_t) {};
  return [what](std::size_t done) {
    std::fprintf(stderr, "\r%-24.24s %zu ", what.c_str(), done);
    std::fflush(stderr);
  };
}

/// A line that is written over itself.
inline std::function<void(const std::string&)> progress_line() {
  if (!isatty(STDERR_FILENO)) return [](const std::string&) {};
  return [](const std::string& text) {
    std::fprintf(stderr, "\r%-100.100s", text.c_str());
    std::fflush(stderr);
  };
}

}  // namespace penumbra::tools
