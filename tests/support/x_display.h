// Test support: an X server that draws nowhere, named by DISPLAY while it lives.
// threads: thread-bound
#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <string>

namespace penumbra::test {

class XDisplay {
 public:
  XDisplay() {
    if (const char* before = ::getenv("DISPLAY")) before_ = before;
    std::array<int, 2> told{};
    if (::pipe2(told.data(), O_CLOEXEC) != 0) return;
    server_ = ::fork();
    if (server_ == 0) {
      ::dup2(told[1], 3);  // which stays open in it
      const int quiet = ::open("/dev/null", O_WRONLY);
      ::dup2(quiet, 2);
      ::execlp("Xvfb", "Xvfb", "-displayfd", "3", "-nolisten", "tcp", nullptr);
      ::_exit(127);
    }
    ::close(told[1]);
    std::string number;
    char c = 0;
    while (::read(told[0], &c, 1) == 1 && c != '\n') number += c;
    ::close(told[0]);
    if (!number.empty()) ::setenv("DISPLAY", (":" + number).c_str(), 1);
    is_there_ = !number.empty();
  }
  ~XDisplay() {
    end();
    if (before_.empty())
      ::unsetenv("DISPLAY");
    else
      ::setenv("DISPLAY", before_.c_str(), 1);
  }
  XDisplay(const XDisplay&) = delete;
  XDisplay& operator=(const XDisplay&) = delete;

  /// False: Xvfb is not installed.
  [[nodiscard]] bool is_there() const { return is_there_; }
  void end() {
    if (server_ <= 0) return;
    ::kill(server_, SIGKILL);
    ::waitpid(server_, nullptr, 0);
    server_ = 0;
  }

 private:
  std::string before_;
  pid_t server_ = 0;
  bool is_there_ = false;
};

}  // namespace penumbra::test
