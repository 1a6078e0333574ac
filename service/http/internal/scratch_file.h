// A file of this process alone, gone with its owner.
// threads: thread-bound
#pragma once

#include <atomic>
#include <filesystem>
#include <string>

#include <fmt/format.h>
#include <unistd.h>

namespace penumbra::service {

class ScratchFile {
 public:
  explicit ScratchFile(const std::string& extension) {
    static std::atomic<unsigned> made = 0;
    std::error_code ignored;
    path_ = std::filesystem::temp_directory_path(ignored) /
            fmt::format("penumbra-{}-{}{}", ::getpid(), ++made, extension);
  }
  ~ScratchFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  ScratchFile(const ScratchFile&) = delete;
  ScratchFile& operator=(const ScratchFile&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace penumbra::service
