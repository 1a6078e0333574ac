#include "tests/support/allocations.h"

#include <cstdlib>
#include <new>

#ifndef PENUMBRA_SANITIZED
void* operator new(std::size_t bytes) {
  penumbra::test::allocations.fetch_add(1, std::memory_order_relaxed);
  penumbra::test::allocated_bytes.fetch_add(bytes, std::memory_order_relaxed);
  if (void* p = std::malloc(bytes)) return p;
  throw std::bad_alloc();
}
void* operator new(std::size_t bytes, std::align_val_t alignment) {
  penumbra::test::allocations.fetch_add(1, std::memory_order_relaxed);
  penumbra::test::allocated_bytes.fetch_add(bytes, std::memory_order_relaxed);
  const auto a = static_cast<std::size_t>(alignment);
  if (void* p = std::aligned_alloc(a, (bytes + a - 1) / a * a)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept {
  std::free(p);
}
void operator delete(void* p, std::size_t) noexcept {
  std::free(p);
}
void operator delete(void* p, std::align_val_t) noexcept {
  std::free(p);
}
void operator delete(void* p, std::size_t, std::align_val_t) noexcept {
  std::free(p);
}
#endif
