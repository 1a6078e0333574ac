// What two objects block in common at points of a floor, for many points at once.
// threads: reentrant
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "core/sh.h"

namespace penumbra::shadows {

/// What two objects take at texels where their shadows meet, by coefficient: halves, finite.
struct DeficitBatch {
  static constexpr std::size_t kTexels = 16;
  alignas(64) std::uint16_t first[kMaxCoefficients][kTexels], second[kMaxCoefficients][kTexels];
};

/// Fraction of each one's blocked directions that the other blocks too, 0 to 1: <a,b>/<a,a> and
/// <a,b>/<b,b>, which would be exact for visibilities of 0 and 1. 0 where nothing is blocked.
struct OverlapBatch {
  alignas(64) float of_first[DeficitBatch::kTexels], of_second[DeficitBatch::kTexels];
};

/// turn: what brings the first's coefficients into the second's frame, band by band, row by row; or
///       empty where their frames are one
void find_overlap(const DeficitBatch& deficits, int bands, std::span<const float> turn,
                  OverlapBatch& out);

}  // namespace penumbra::shadows
