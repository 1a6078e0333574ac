// Counts what the program takes from the heap by operator new, on any thread.
#pragma once

#include <atomic>
#include <cstddef>

namespace penumbra::test {
/// Sanitizers bring an operator new of their own, which must stay.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define PENUMBRA_SANITIZED
#elif defined(__has_feature)  // clang
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define PENUMBRA_SANITIZED
#endif
#endif
#ifdef PENUMBRA_SANITIZED
inline constexpr bool kCountsAllocations = false;
#else
inline constexpr bool kCountsAllocations = true;
#endif
inline std::atomic<std::size_t> allocations = 0, allocated_bytes = 0;
}  // namespace penumbra::test
