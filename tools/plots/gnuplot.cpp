#include "tools/plots/gnuplot.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string_view>

#include "core/io/files.h"

namespace penumbra::tools {

namespace {

// A file that lives in memory only and goes with its descriptor.
class MemoryFile {
 public:
  explicit MemoryFile(const char* name) : fd_(::memfd_create(name, MFD_CLOEXEC)) {}
  ~MemoryFile() {
    if (fd_ >= 0) ::close(fd_);
  }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;

  int fd() const { return fd_; }
  bool write(std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t n = ::write(fd_, bytes.data(), bytes.size());
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(n));
    }
    return ::lseek(fd_, 0, SEEK_SET) == 0;
  }
  std::string read_start() const {
    char buffer[2048];
    const ssize_t n = ::pread(fd_, buffer, sizeof buffer, 0);
    return {buffer, static_cast<std::size_t>(n > 0 ? n : 0)};
  }

 private:
  int fd_;
};

class SpawnActions {
 public:
  SpawnActions() { ::posix_spawn_file_actions_init(&actions_); }
  ~SpawnActions() { ::posix_spawn_file_actions_destroy(&actions_); }
  SpawnActions(const SpawnActions&) = delete;
  SpawnActions& operator=(const SpawnActions&) = delete;

  posix_spawn_file_actions_t* get() { return &actions_; }

 private:
  posix_spawn_file_actions_t actions_;
};

// gnuplot marks the place of an error with lines of its own around it.
std::string complaint(const MemoryFile& errors) {
  std::string out;
  for (const char c : errors.read_start()) {
    const bool space = c == '\n' || c == ' ' || c == '\t';
    if (!space)
      out += c;
    else if (!out.empty() && out.back() != ' ')
      out += ' ';
  }
  return out.empty() ? "gnuplot failed without a word" : "gnuplot: " + out;
}

Result<pid_t> start(const MemoryFile& script, const MemoryFile& errors,
                    const std::filesystem::path& output) {
  SpawnActions actions;
  ::posix_spawn_file_actions_adddup2(actions.get(), script.fd(), STDIN_FILENO);
  ::posix_spawn_file_actions_addopen(actions.get(), STDOUT_FILENO, output.c_str(),
                                     O_WRONLY | O_CREAT | O_TRUNC, 0666);
  ::posix_spawn_file_actions_adddup2(actions.get(), errors.fd(), STDERR_FILENO);
  char name[] = "gnuplot", defaults[] = "-d", input[] = "-";
  char* const arguments[] = {name, defaults, input, nullptr};
  pid_t child = 0;
  const int error = ::posix_spawnp(&child, name, actions.get(), nullptr, arguments, environ);
  if (error == 0) return child;
  // ENOENT is also what a missing folder of the output says.
  std::error_code ignored;
  const auto folder = output.has_parent_path() ? output.parent_path() : ".";
  if (!std::filesystem::is_directory(folder, ignored))
    return fail(ErrorCode::kUnwritable, output.string(), "no such folder");
  if (error == ENOENT)
    return fail(ErrorCode::kUnavailable, "gnuplot",
                "not installed; the Debian package gnuplot-nox has it");
  return fail(ErrorCode::kUnwritable, output.string(), std::strerror(error));
}

Result<void> wait_for(pid_t child, const MemoryFile& errors) {
  int status = 0;
  while (::waitpid(child, &status, 0) < 0)
    if (errno != EINTR) return fail(ErrorCode::kUnavailable, "gnuplot", std::strerror(errno));
  if (WIFEXITED(status) && WEXITSTATUS(status) == 0) return {};
  return fail(ErrorCode::kUnwritable, "gnuplot", complaint(errors));
}

// Control characters become spaces, characters outside ASCII '?'.
std::string printable(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (byte >= 0x80 && byte < 0xc0) continue;  // continues a character that is '?' already
    out += byte >= 0xc0 ? '?' : byte < 0x20 || byte == 0x7f ? ' ' : c;
  }
  return out;
}

}  // namespace

std::string gnuplot_quoted(const std::string& text) {
  std::string out = "'";
  for (const char c : printable(text)) out += c == '\'' ? "''" : std::string(1, c);
  return out + "'";
}

std::string gnuplot_cell(const std::string& text) {
  std::string out = "\"";
  for (const char c : printable(text)) out += c == '"' || c == '`' ? '?' : c;
  return out + "\"";
}

std::string gnuplot_block(const std::string& name, const std::string& rows) {
  constexpr std::string_view kEnd = "END_OF_BLOCK";
  std::string out = fmt::format("${} << {}\n", name, kEnd);
  for (std::size_t from = 0; from < rows.size();) {
    const std::size_t to = std::min(rows.find('\n', from), rows.size());
    const std::string_view row = std::string_view(rows).substr(from, to - from);
    if (row.starts_with(kEnd)) out += '?';
    for (const char c : row) out += c == '`' ? '?' : c;
    out += '\n';
    from = to + 1;
  }
  return fmt::format("{}{}\n", out, kEnd);
}

Result<void> run_gnuplot(const std::string& script, const std::filesystem::path& target) {
  const MemoryFile input("gnuplot-script"), errors("gnuplot-errors");
  if (input.fd() < 0 || errors.fd() < 0 || !input.write(script))
    return fail(ErrorCode::kUnavailable, "gnuplot", std::strerror(errno));
  return replace_file(target, [&](const std::filesystem::path& temporary) -> Result<void> {
    PENUMBRA_ASSIGN(child, start(input, errors, temporary));
    PENUMBRA_TRY(wait_for(child, errors));
    std::error_code error;
    if (std::filesystem::file_size(temporary, error) == 0 || error)
      return fail(ErrorCode::kUnwritable, target.string(), complaint(errors));
    return {};
  });
}

}  // namespace penumbra::tools
