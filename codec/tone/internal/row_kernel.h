// Loops over rows of pixels that are worth vector code.
// threads: reentrant
#pragma once

#include <cstddef>
#include <span>

namespace penumbra::tone {

/// Floats that rows of level_set_row() have beyond both of their ends: a vector may hang over.
inline constexpr std::size_t kRowPadding = 64;

/// What one step of the level set does, in units of the logarithm as it is given.
struct LevelSetRow {
  float inverse_scale_squared;  // of the scale to the range of 10
  float decay;                  // of the edge's weight, by the second difference
  float log2_step;              // of the time, at most kLargestStep
};

/// Up to here the scheme with central differences is stable: a quarter of the squared spacing.
inline constexpr double kLargestStep = .25;

/// The row after one step. Of the rows beside it and of itself the floats at -1 and at `count` are
/// read as neighbours, and what lies beyond as anything; `out` is written beyond `count`, too.
void level_set_row(const float* above, const float* row, const float* below, const LevelSetRow& how,
                   std::size_t count, float* out);

/// Natural logarithms and exponentials in place, to about 4 units in the last place; logarithms of
/// positive normal numbers, exponentials between -87 and 88.
void log_in_place(std::span<float> values);
void exp_in_place(std::span<float> values);

}  // namespace penumbra::tone
