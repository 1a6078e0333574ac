// Sums of rows of half floats: what relighting by coefficients and by components is.
#pragma once

#include <cstdint>
#include <span>

namespace penumbra::prt {

/// One channel serves all three colours.
struct Rows {
  std::span<const std::uint16_t> values;  // half floats, [channel][row][point]
  std::size_t stride;                     // a multiple of 64
  int channels;                           // 1 or 3
};

/// out[channel * stride + point] = sum over the first `used` rows of weights[3 row + channel] times the row's value.
/// threads: reentrant, no allocation
void relight(const Rows& rows, int used, std::span<const float> weights, std::span<float> out);

}  // namespace penumbra::prt
