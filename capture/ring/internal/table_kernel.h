// Inner loops of the table merge, with run-time choice of the vector instructions.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/image.h"

namespace penumbra::capture {

/// Pixels that are sorted out together; everything stays in cache.
inline constexpr int kMergeBlock = 256;
inline constexpr int kBlockSamples = 3 * kMergeBlock;

struct TableView {
  const std::uint16_t* channel[3];  // [step][code of next][code]
  const std::uint8_t* clip;         // first clipped code, kBlockSamples values in channel order
  const std::uint8_t* black;        // first code that is not black, likewise
  int steps;                        // exposures
};
struct BlockCounts {
  std::uint16_t clipped = 0;  // pixels clipped everywhere in some channel
  std::uint16_t black = 0;    // samples black in the longest exposure
  std::uint8_t deepest = 0;   // the shortest exposure that had a say; shorter ones were not read
};

/// Merges one whole block: codes[k] points to the block in exposure k, longest first.
BlockCounts merge_block(const TableView& tables, const std::uint8_t* const* codes, HalfRgba* out);

/// How far a code may lie from another: by the upper half of its bits.
struct CodeTolerance {
  std::uint8_t often[16];  // beyond this, chance may put a few samples of a block
  std::uint8_t ever[16];   // and beyond this, none
};
/// Whether a block shows something else than before.
bool block_changed(const CodeTolerance& tolerance, const std::uint8_t* now,
                   const std::uint8_t* before);

/// Marks the samples of a block that lie outside the interval which the known samples allow: 255,
/// else 0. allowed[offset of the sample + known code] is low | high << 8.
void mark_outside(const std::uint32_t* allowed, const std::int32_t* offsets,
                  const std::uint8_t* known, const std::uint8_t* asked, std::uint8_t* outside);

/// Sums of (before - after) over the marked pixels of each run of kMergeRun; the fourth number
/// means nothing.
inline constexpr int kMergeRun = 16;
void sum_differences(const HalfRgba* before, const HalfRgba* after, const std::uint8_t* marked,
                     float (*sums)[4]);

}  // namespace penumbra::capture
