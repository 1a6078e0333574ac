// Loops spread over the machine's cores by TBB. The call returns when all is done; an exception of
// a body ends the loop and comes out of the call. Bodies run at the same time on several threads
// and share no mutable state.
// threads: reentrant, parallel inside
#pragma once

#include <concepts>
#include <cstdint>
#include <type_traits>

#pragma GCC visibility push(default)
namespace penumbra {

// A part of [begin, end), handed to a body.
template <std::integral Index>
struct Indices {
  Index first, last;
  [[nodiscard]] Index begin() const { return first; }
  [[nodiscard]] Index end() const { return last; }
  [[nodiscard]] Index size() const { return static_cast<Index>(last - first); }
};

namespace detail {
using LoopBody = void (*)(const void* body, std::int64_t first, std::int64_t last);
// What is the same for all loops stands in parallel.cpp: TBB's headers cost every file that loops a
// second and a half.
void run_parts(std::int64_t first, std::int64_t last, std::int64_t grain, const void* body,
               LoopBody part);
}  // namespace detail

// body(Indices) over [first, last) in parts of about `grain` (at least 1) indices.
template <std::integral Index, class Body>
void parallel_for(Index first, std::type_identity_t<Index> last, std::type_identity_t<Index> grain,
                  const Body& body) {
  const auto part = [](const void* of, std::int64_t from, std::int64_t to) {
    (*static_cast<const Body*>(of))(
        Indices<Index>{static_cast<Index>(from), static_cast<Index>(to)});
  };
  detail::run_parts(static_cast<std::int64_t>(first), static_cast<std::int64_t>(last),
                    static_cast<std::int64_t>(grain), &body, part);
}

// body(index) over [first, last), for bodies that are dear one by one.
template <std::integral Index, class Body>
void parallel_for(Index first, std::type_identity_t<Index> last, const Body& body) {
  parallel_for(first, last, 1, [&](const Indices<Index>& part) {
    for (Index i = part.begin(); i < part.end(); ++i) body(i);
  });
}

/// This thread, until it ends, takes what others leave: it gives way where a processor is busy, and
/// its loops run on itself alone.
void work_in_background();

}  // namespace penumbra
#pragma GCC visibility pop
