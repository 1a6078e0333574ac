// Counts what the program takes from the heap by operator new, on any thread.
#pragma once

#include <atomic>
#include <cstddef>

namespace penumbra::test {
inline std::atomic<std::size_t> allocations = 0, allocated_bytes = 0;
}  // namespace penumbra::test
