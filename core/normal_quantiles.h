// Noise from a table: the normal distribution at equal steps of probability.
// threads: reentrant
#pragma once

#include <cstddef>
#include <vector>

#pragma GCC visibility push(default)
namespace penumbra {

/// Quantiles at the middles of `count` equal fractions, rising, scaled to unit variance. Takes
/// milliseconds: kept by whoever uses it.
/// in: count even
std::vector<float> normal_quantiles(std::size_t count);

}  // namespace penumbra
#pragma GCC visibility pop
