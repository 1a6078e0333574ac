// A progress bar on standard error for long work; silent when that is not a terminal.
#pragma once

#include <unistd.h>

#include <cstddef>
#include <cstdio>
#include <functional>
#include <string>

namespace penumbra::service {

inline std::function<void(double)> progress_bar(const std::string& what) {
  if (!isatty(STDERR_FILENO)) return {};
  return [what, last = -1](double done) mutable {
    const int percent = static_cast<int>(done * 100);
    if (percent == last) return;
    last = percent;
    const std::string bar(static_cast<std::size_t>(percent * 30 / 100), '#');
    std::fprintf(stderr, "\r%-24.24s [%-30s] %3d %%%s", what.c_str(), bar.c_str(), percent,
                 percent >= 100 ? "\n" : "");
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

}  // namespace penumbra::service
