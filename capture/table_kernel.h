// Inner loops of the table merge, with run-time choice of the vector instructions.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/image.h"

namespace penumbra::capture {

/// Pixels that are sorted out together; everything stays in cache.
inline constexpr int kMergeBlock = 256;

struct TableView {
  const std::uint16_t* channel[3];  // [step][code of next][code]
  const std::uint8_t* clip;         // first clipped code, 3 * kMergeBlock values in channel order
  const std::uint8_t* black;        // first code that is not black, likewise
  int steps;                        // exposures
};
struct BlockCounts {
  std::size_t clipped = 0;  // pixels clipped everywhere in some channel
  std::size_t black = 0;    // samples black in the longest exposure
};

/// Merges one whole block: codes[k] points to the block in exposure k, longest first.
BlockCounts merge_block(const TableView& tables, const std::uint8_t* const* codes, HalfRgba* out);

}  // namespace penumbra::capture
