// A picture's signal on a coarse grid: what labels, bands and white balance are judged by.
// threads: thread-bound
#pragma once

#include <optional>
#include <vector>

#include "calib/camera/response_table.h"
#include "capture/frames.h"
#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Cells of equal size, and the samples that each is measured by.
struct CellGrid {
  int columns, rows;
  int samples_across, samples_down;  // of a cell, evenly spread
  float dark = 0;                    // mean linear signal of a sample below which it is all noise
  int cells() const { return columns * rows; }
};

/// Mean linear signals of cells.
class CellMeter {
 public:
  explicit CellMeter(const CameraInfo& camera) : camera_(camera) {}
  /// Row by row, in fractions of full scale; NaN where a sample is clipped (kClipLevel) or dark.
  /// Empty for float frames.
  void measure(const FramePixels& pixels, const CellGrid& grid, std::vector<Rgb>& out);
  /// The response that frames of so many bits are read by.
  const ResponseTable& curve(int bits);

 private:
  CameraInfo camera_;
  std::optional<ResponseTable> curve_;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
