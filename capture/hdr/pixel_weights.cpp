#include "capture/hdr/pixel_weights.h"

#include <algorithm>
#include <glm/geometric.hpp>

namespace penumbra::capture {

PixelWeights::PixelWeights(const calib::CameraModel& projection)
    : width_(static_cast<std::size_t>(projection.width)), columns_((width_ + kCell - 1) / kCell) {
  const int rows = (projection.height + kCell - 1) / kCell;
  // The parallelogram of a pixel in the middle of the cell, or of the picture's last one.
  const auto direction = [&](double x, double y) {
    return calib::direction_from_pixel(projection, {x, y});
  };
  for (int row = 0; row < rows; ++row)
    for (std::size_t column = 0; column < columns_; ++column) {
      const double x = std::min<double>((static_cast<double>(column) + .5) * kCell,
                                        projection.width),
                   y = std::min<double>((row + .5) * kCell, projection.height);
      const auto corner = direction(x, y), left = direction(x - 1, y), above = direction(x, y - 1);
      const bool seen = corner && left && above;
      weights_.push_back(
          seen ? static_cast<float>(glm::length(glm::cross(*corner - *left, *corner - *above)))
               : 0.f);
    }
}

}  // namespace penumbra::capture
