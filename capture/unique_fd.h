// Owners of a file descriptor and of a mapping.
// threads: thread-bound
#pragma once

#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <span>
#include <utility>

#pragma GCC visibility push(default)
namespace penumbra::capture {

class UniqueFd {
 public:
  UniqueFd() = default;
  explicit UniqueFd(int fd) : fd_(fd) {}
  ~UniqueFd() {
    if (fd_ >= 0) ::close(fd_);
  }
  UniqueFd(UniqueFd&& o) noexcept : fd_(std::exchange(o.fd_, -1)) {}
  UniqueFd& operator=(UniqueFd&& o) noexcept {
    std::swap(fd_, o.fd_);
    return *this;
  }
  int get() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

class MappedBuffer {
 public:
  MappedBuffer() = default;
  MappedBuffer(int fd, std::size_t bytes, off_t offset) : bytes_(bytes) {
    void* at = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, fd, offset);
    at_ = at == MAP_FAILED ? nullptr : at;
  }
  ~MappedBuffer() {
    if (at_) ::munmap(at_, bytes_);
  }
  MappedBuffer(MappedBuffer&& o) noexcept
      : at_(std::exchange(o.at_, nullptr)), bytes_(std::exchange(o.bytes_, 0)) {}
  MappedBuffer& operator=(MappedBuffer&& o) noexcept {
    std::swap(at_, o.at_);
    std::swap(bytes_, o.bytes_);
    return *this;
  }
  explicit operator bool() const { return at_ != nullptr; }
  std::span<const std::byte> bytes() const { return {static_cast<const std::byte*>(at_), bytes_}; }

 private:
  void* at_ = nullptr;
  std::size_t bytes_ = 0;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
