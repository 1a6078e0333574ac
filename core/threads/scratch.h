// Memory for the temporaries of one call, kept for the next: after the largest call nothing comes
// from the heap.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <memory_resource>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// A stack of bytes for std::pmr containers. What a Scope handed out is gone with it.
/// threads: each thread has its own; scopes nest. A thread that waits in TBB inside a scope may
/// open another one on top
class Scratch final : public std::pmr::memory_resource {
 public:
  class Scope {
   public:
    Scope() : scratch_(Scratch::here()), mark_(scratch_.used_) { ++scratch_.scopes_; }
    ~Scope() { scratch_.leave(mark_); }
    Scope(const Scope&) = delete;
    Scope& operator=(const Scope&) = delete;
    std::pmr::memory_resource* memory() const { return &scratch_; }

   private:
    Scratch& scratch_;
    std::size_t mark_;
  };

 private:
  static Scratch& here() {
    thread_local Scratch one;
    return one;
  }

  void* do_allocate(std::size_t bytes, std::size_t alignment) override {
    void* at = block_.get() + used_;
    std::size_t space = size_ - used_;
    if (std::align(alignment, bytes, at, space)) {
      used_ = size_ - space + bytes;
      max_ = std::max(max_, used_);
      return at;
    }
    // Does not fit this time; the block will be larger when the last scope has ended.
    missing_ += bytes + alignment;
    overflow_.push_back(
        {std::pmr::new_delete_resource()->allocate(bytes, alignment), bytes, alignment});
    return overflow_.back().at;
  }
  void do_deallocate(void*, std::size_t, std::size_t) override {}  // with its scope
  bool do_is_equal(const memory_resource& other) const noexcept override { return this == &other; }

  void leave(std::size_t mark) {
    used_ = mark;
    if (--scopes_ > 0) return;
    for (const Overflow& o : overflow_)
      std::pmr::new_delete_resource()->deallocate(o.at, o.bytes, o.alignment);
    overflow_.clear();
    if (missing_ == 0) return;
    size_ = max_ + missing_ + missing_ / 2;
    block_ = std::make_unique_for_overwrite<std::byte[]>(size_);
    missing_ = 0;
  }

  struct Overflow {
    void* at;
    std::size_t bytes, alignment;
  };
  std::unique_ptr<std::byte[]> block_;
  std::size_t size_ = 0, used_ = 0, max_ = 0, missing_ = 0;
  int scopes_ = 0;
  std::vector<Overflow> overflow_;
};

}  // namespace penumbra
#pragma GCC visibility pop
