// A progress bar on standard error for long work; silent when that is not a terminal.
#pragma once

#include <unistd.h>

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

}  // namespace penumbra::service
