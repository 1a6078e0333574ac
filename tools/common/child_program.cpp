#include "tools/common/child_program.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>

namespace penumbra::tools {

namespace {

constexpr std::size_t kMaxBytes = std::size_t{1} << 20;

// One of the child's three streams, in memory: no pipe fills up while nobody reads.
class ChildStream {
 public:
  explicit ChildStream(const char* name) : fd_(::memfd_create(name, MFD_CLOEXEC)) {}
  ~ChildStream() {
    if (fd_ >= 0) ::close(fd_);
  }
  ChildStream(const ChildStream&) = delete;
  ChildStream& operator=(const ChildStream&) = delete;

  int fd() const { return fd_; }
  bool fill(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t n = ::write(fd_, bytes.data(), bytes.size());
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(n));
    }
    return ::lseek(fd_, 0, SEEK_SET) == 0;
  }
  std::string text() const {
    std::string out;
    std::array<char, 4096> part{};
    while (out.size() < kMaxBytes) {
      const ssize_t n = ::pread(fd_, part.data(), part.size(), static_cast<off_t>(out.size()));
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) break;
      out.append(part.data(), static_cast<std::size_t>(n));
    }
    return out;
  }

 private:
  int fd_;
};

class ChildFiles {
 public:
  ChildFiles() { ::posix_spawn_file_actions_init(&actions_); }
  ~ChildFiles() { ::posix_spawn_file_actions_destroy(&actions_); }
  ChildFiles(const ChildFiles&) = delete;
  ChildFiles& operator=(const ChildFiles&) = delete;

  void put(const ChildStream& stream, int as) {
    ::posix_spawn_file_actions_adddup2(&actions_, stream.fd(), as);
  }
  void make(const std::filesystem::path& file, int as) {
    ::posix_spawn_file_actions_addopen(&actions_, as, file.c_str(), O_WRONLY | O_CREAT | O_TRUNC,
                                       0666);
  }
  const posix_spawn_file_actions_t* get() const { return &actions_; }

 private:
  posix_spawn_file_actions_t actions_;
};

}  // namespace

Result<ChildAnswer> run_child(const std::vector<std::string>& command, std::string_view input,
                              const std::filesystem::path& output_file) {
  const ChildStream in("input"), out("output"), errors("errors");
  if (in.fd() < 0 || out.fd() < 0 || errors.fd() < 0 || !in.fill(input))
    return fail(ErrorCode::kUnavailable, command[0], std::strerror(errno));
  ChildFiles files;
  files.put(in, STDIN_FILENO);
  if (output_file.empty())
    files.put(out, STDOUT_FILENO);
  else
    files.make(output_file, STDOUT_FILENO);
  files.put(errors, STDERR_FILENO);
  std::vector<char*> arguments;
  for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  pid_t child = 0;
  const int error =
      ::posix_spawnp(&child, arguments[0], files.get(), nullptr, arguments.data(), environ);
  // ENOENT is also what a missing folder of the output says.
  std::error_code ignored;
  const auto folder = output_file.has_parent_path() ? output_file.parent_path() : ".";
  if (error != 0 && !output_file.empty() && !std::filesystem::is_directory(folder, ignored))
    return fail(ErrorCode::kUnwritable, output_file.string(), "no such folder");
  if (error == ENOENT) return fail(ErrorCode::kUnavailable, command[0], "is not installed");
  if (error != 0) return fail(ErrorCode::kUnavailable, command[0], std::strerror(error));
  int status = 0;
  while (::waitpid(child, &status, 0) < 0)
    if (errno != EINTR) return fail(ErrorCode::kUnavailable, command[0], std::strerror(errno));
  const int code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return ChildAnswer{code, out.text(), errors.text()};
}

}  // namespace penumbra::tools
