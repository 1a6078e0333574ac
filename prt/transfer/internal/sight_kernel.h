// The inner loop of SightLookup.
#pragma once

#include "prt/transfer/vertex_sight.h"

namespace penumbra::prt {

struct SightRows {
  const SightHead* heads;  // by vertex
  const std::uint32_t* open;
  const std::uint64_t* fine;
  const float *x, *y, *z, *counts;  // SightTaps, turn by turn
  std::size_t each, turns;
  const std::uint32_t* which;  // vertices; null: all
};
/// [first, last) of the vertices.
void look_coarse(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out);
void look_fine(const SightRows& rows, std::size_t first, std::size_t last, CosineSums* out);

}  // namespace penumbra::prt
