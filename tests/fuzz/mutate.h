// A little fuzzing in every test run: damage done to good bytes, the same on every machine.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <random>
#include <span>
#include <vector>

namespace penumbra::test {

namespace detail {

// One to eight changes, each at a place and of a kind that the generator chooses.
inline std::vector<unsigned char> mutated(std::span<const unsigned char> seed,
                                          std::mt19937_64& rng) {
  std::vector<unsigned char> bytes(seed.begin(), seed.end());
  // The distributions of <random> differ between libraries; the generators do not.
  const auto below = [&](std::size_t n) {
    return static_cast<std::size_t>(rng() % std::max<std::size_t>(n, 1));
  };
  const auto at = [&](std::size_t i) { return bytes.begin() + static_cast<std::ptrdiff_t>(i); };
  for (std::size_t changes = 1 + below(8); changes > 0 && !bytes.empty(); --changes) {
    const std::size_t where = below(bytes.size());
    const std::size_t length = 1 + below(std::min<std::size_t>(bytes.size() - where, 16));
    switch (below(6)) {
      case 0:
        bytes[where] ^= static_cast<unsigned char>(1u << below(8));
        break;
      case 1:
        bytes[where] = static_cast<unsigned char>(rng());
        break;
      case 2:
        if (below(8) == 0) bytes.resize(where);
        break;  // rarely, or little else is seen
      case 3:
        bytes.insert(at(where), length, static_cast<unsigned char>(rng()));
        break;
      case 4:
        bytes.erase(at(where), at(where + length));
        break;
      default: {
        const std::vector<unsigned char> block(at(where), at(where + length));
        const std::size_t to = below(bytes.size() - length + 1);
        std::ranges::copy(block, at(to));
      }
    }
  }
  bytes.shrink_to_fit();  // a read past the end then leaves the allocation, and a sanitizer sees it
  return bytes;
}

}  // namespace detail

/// Calls `function` with `iterations` damaged copies of `seed`.
inline void mutate_and_run(std::span<const unsigned char> seed, int iterations,
                           std::uint64_t rng_seed,
                           const std::function<void(std::span<const unsigned char>)>& function) {
  std::mt19937_64 rng(rng_seed);
  for (int i = 0; i < iterations; ++i) function(detail::mutated(seed, rng));
}

}  // namespace penumbra::test
