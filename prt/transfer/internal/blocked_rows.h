// Sums of rows of half floats that lie together by blocks of points.
#pragma once

#include <cstdint>
#include <span>

namespace penumbra::prt {

/// Points of a block: their rows follow each other, so that memory is read as one stream while sums
/// stay in registers.
inline constexpr std::size_t kBlock = 32;

/// One channel serves all three colours.
struct BlockedRows {
  std::span<const std::uint16_t> values;  // half floats, [block][channel][row][point of the block]
  int rows;
  int channels;  // 1 or 3
};

/// out[channel * points + point] = sum over `used` rows from `first` on of
/// weights[3 (row - first) + channel] times the row's value.
/// out: 3 floats a point.
/// threads: reentrant, no allocation
void sum_rows(const BlockedRows& from, int first, int used, std::span<const float> weights,
              std::span<float> out);

}  // namespace penumbra::prt
