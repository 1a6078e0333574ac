// How bright a map is, row by row: what finding its sources begins with.
#pragma once

#include <vector>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::lighting {

inline constexpr int kPeakBlock = 64;  // pixels
constexpr int peak_blocks(int width) {
  return (width + kPeakBlock - 1) / kPeakBlock;
}

struct MapLuminance {
  std::vector<double> row_sum;    // not finite where a pixel is not
  std::vector<float> block_peak;  // by row, peak_blocks(width) each: the largest value, at least 0

  /// Keeps its memory.
  void resize(int width, int height) {
    row_sum.resize(static_cast<std::size_t>(height));
    block_peak.resize(static_cast<std::size_t>(height) *
                      static_cast<std::size_t>(peak_blocks(width)));
  }
  bool is_of(const Image<Rgb>& map) const {
    return row_sum.size() == static_cast<std::size_t>(map.height()) &&
           block_peak.size() == row_sum.size() * static_cast<std::size_t>(peak_blocks(map.width()));
  }
  /// threads: rows may be read at the same time
  void read_row(const Image<Rgb>& map, int y);
};

}  // namespace penumbra::lighting
#pragma GCC visibility pop
