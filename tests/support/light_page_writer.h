// A page of light as the daemon writes it, for tests of what reads it.
// threads: one writer; readers anywhere
#pragma once

#include <fcntl.h>
#include <linux/futex.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <climits>
#include <cstdint>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <stdexcept>
#include <string>

#include "service/client/penumbra_light_page.h"

namespace penumbra::test {

class LightPageWriter {
 public:
  /// Makes the file, or writes into one that is there.
  explicit LightPageWriter(const std::filesystem::path& path) {
    fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
    if (fd_ < 0 || ::flock(fd_, LOCK_EX | LOCK_NB) != 0 || ::ftruncate(fd_, sizeof *page_) != 0)
      throw std::runtime_error(path.string() + ": " + std::strerror(errno));
    void* mapped = ::mmap(nullptr, sizeof *page_, PROT_READ | PROT_WRITE, MAP_SHARED, fd_, 0);
    if (mapped == MAP_FAILED) throw std::runtime_error(path.string() + ": " + std::strerror(errno));
    page_ = static_cast<penumbra_light_page*>(mapped);
    page_->version = PENUMBRA_LIGHT_PAGE_VERSION;
    page_->bytes = sizeof *page_;
    page_->writer_pid = static_cast<std::uint32_t>(::getpid());
    std::memcpy(page_->magic, PENUMBRA_LIGHT_PAGE_MAGIC, sizeof page_->magic);
  }
  ~LightPageWriter() {
    ::munmap(page_, sizeof *page_);
    ::close(fd_);
  }
  LightPageWriter(const LightPageWriter&) = delete;
  LightPageWriter& operator=(const LightPageWriter&) = delete;

  /// For what a test writes in its own way, such as a damaged header.
  penumbra_light_page& page() { return *page_; }

  void write(const penumbra_light& light) { put(page_->light_sequence, page_->light, light); }
  void write(const penumbra_objects& objects) {
    put(page_->objects_sequence, page_->objects, objects);
  }
  void write(const penumbra_cube& cube) { put(page_->cube_sequence, page_->cube, cube); }

  /// As a writer that dies in the middle of a light.
  void leave_half_written() {
    __atomic_store_n(&page_->light_sequence, page_->light_sequence | 1, __ATOMIC_RELEASE);
  }

  static std::int64_t monotonic_ns() {
    timespec t{};
    ::clock_gettime(CLOCK_MONOTONIC, &t);
    return std::int64_t{t.tv_sec} * 1'000'000'000 + t.tv_nsec;
  }

 private:
  template <class Part>
  static void put(std::uint32_t& sequence, Part& to, const Part& from) {
    const std::uint32_t odd = sequence | 1;
    __atomic_store_n(&sequence, odd, __ATOMIC_RELEASE);
    auto* words = reinterpret_cast<std::uint64_t*>(&to);
    for (std::size_t n = 0; n < sizeof from / sizeof *words; ++n) {
      std::uint64_t word = 0;
      std::memcpy(&word, reinterpret_cast<const char*>(&from) + n * sizeof word, sizeof word);
      __atomic_store_n(&words[n], word, __ATOMIC_RELEASE);  // keeps behind the odd number
    }
    __atomic_store_n(&sequence, odd + 1, __ATOMIC_RELEASE);
    ::syscall(SYS_futex, &sequence, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
  }

  int fd_ = -1;
  penumbra_light_page* page_ = nullptr;
};

}  // namespace penumbra::test
