// How much of the sphere a pixel sees, where a whole table would be more than is needed.
// threads: const members reentrant
#pragma once

#include <cstddef>
#include <vector>

#include "calib/camera/camera_model.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// Solid angles of the pixels of a projection, relative to each other, the same for a cell of
/// pixels; 0 where the cell's middle is not seen.
class PixelWeights {
 public:
  static constexpr int kCell = 16;  // pixels a side
  explicit PixelWeights(const calib::CameraModel& projection);
  float of(int x, int y) const {
    return weights_[static_cast<std::size_t>(y / kCell) * columns_ +
                    static_cast<std::size_t>(x / kCell)];
  }
  float of(std::size_t pixel) const {
    return of(static_cast<int>(pixel % width_), static_cast<int>(pixel / width_));
  }

 private:
  std::size_t width_, columns_;
  std::vector<float> weights_;
};

}  // namespace penumbra::capture
#pragma GCC visibility pop
