// Sums of the cosine and of spherical harmonics over what a vertex cannot see.
// threads: const members reentrant
#pragma once

#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "prt/bake/internal/visibility_bake.h"
#include "prt/transfer/visibility_map.h"

namespace penumbra::prt {

/// Integrals of Y_n cos/pi over the cells of a hemi-octahedral square (HemiOctFrame), whose normal
/// is +z: exact for any part of it that cells make up, whatever their size.
class HemiOctSums {
 public:
  explicit HemiOctSums(int bands);

  /// Of a wide cell (VisibilityBake), the fraction of an unoccluded hemisphere's cosine.
  float wide_weight(int x, int y) const;

  struct Blocked {
    /// Fraction of the cosine that is blocked, by halves of the finer cells as on a chessboard.
    float white = 0, black = 0;
    float all() const { return white + black; }
    /// From what the halves differ by; an upper bound, since together they lie closer.
    float standard_error() const { return std::abs(white - black); }
  };
  /// What is not open, and where `below` all that lies below the receiver's plane; coefficients in
  /// the axes of `frame`'s vectors.
  Blocked add_blocked(const OpenCells& open, const HemiOctFrame& frame, bool below,
                      std::span<float> coefficients) const;

 private:
  OpenCells cells_below(const HemiOctFrame& frame) const;
  void add(const std::vector<float>& table, std::size_t cell, std::span<float> sum) const;
  float weight(const std::vector<float>& table, std::size_t cell) const;

  int bands_;
  std::size_t terms_;
  std::vector<float> fine_, cells_, blocks_;  // [cell, row by row][n]
  std::vector<float> x_, y_, z_;              // directions of finer cells' middles, not unit
};

}  // namespace penumbra::prt
