// The inner loop of VisibilityLookup.
#pragma once

#include "prt/transfer/visibility_map.h"

namespace penumbra::prt {

struct VisibilityRows {
  const VisibilityHead* heads;  // by vertex
  const std::uint32_t* open;
  const std::uint64_t* fine;
  const float *x, *y, *z, *counts;  // VisibilitySamples, turn by turn
  std::size_t each, turns;
  const std::uint32_t* which;  // vertices; null: all
};
/// [first, last) of the vertices.
void look_coarse(const VisibilityRows& rows, std::size_t first, std::size_t last, CosineSums* out);
void look_fine(const VisibilityRows& rows, std::size_t first, std::size_t last, CosineSums* out);

}  // namespace penumbra::prt
