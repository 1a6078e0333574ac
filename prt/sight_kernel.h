// The inner loop of SightLookup.
#pragma once

#include "prt/vertex_sight.h"

namespace penumbra::prt {

struct SightRows {
  const SightFrame* frames;    // by vertex
  const std::uint32_t* words;  // by vertex, words_each of them
  std::size_t words_each;
  int cells;
  const float *x, *y, *z, *counts;  // SightTaps, turn by turn
  std::size_t turns;
};
/// Vertices [first, last).
void look(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out);

}  // namespace penumbra::prt
