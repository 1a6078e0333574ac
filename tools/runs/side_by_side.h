// Pictures in a row, for films and sheets.
// threads: reentrant
#pragma once

#include <algorithm>
#include <span>

#include "core/image.h"

namespace penumbra::tools {

/// From the left to the right.
/// in: at least one, all of one height
template <class Pixel>
Image<Pixel> side_by_side(std::span<const Image<Pixel>> pictures) {
  int width = 0;
  for (const Image<Pixel>& p : pictures) width += p.width();
  Image<Pixel> out(width, pictures[0].height());
  int left = 0;
  for (const Image<Pixel>& p : pictures) {
    for (int y = 0; y < out.height(); ++y) std::ranges::copy(p.row(y), out.row(y).begin() + left);
    left += p.width();
  }
  return out;
}

}  // namespace penumbra::tools
