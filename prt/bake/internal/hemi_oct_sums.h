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

/// Integrals of Y_n cos/pi over the cells of a hemi-octahedral square (HemiOctFrame) around their
/// rays, whose normal is +z; by the midpoint rule with sixteen places a cell.
class HemiOctSums {
 public:
  explicit HemiOctSums(int bands);

  /// Of a wide cell (VisibilityBake), the fraction of an unoccluded hemisphere's cosine.
  float wide_weight(int x, int y) const {
    return wide_[static_cast<std::size_t>(VisibilityBake::kWideCells * y + x)];
  }

  struct Blocked {
    float fraction = 0;  // of the cosine
    /// From what halves of the finer cells differ by, as on a chessboard. What hides from all rays
    /// of a wide cell is not in it.
    float standard_error = 0;
  };
  /// What is not open, and where `below` all that lies below the receiver's plane; coefficients in
  /// the axes of `frame`'s vectors.
  Blocked add_blocked(const OpenCells& open, const HemiOctFrame& frame, bool below,
                      std::span<float> coefficients) const;

 private:
  // Of rays that go through one place of their cells.
  struct Tables {
    std::vector<float> fine, cells, blocks;  // [cell, row by row][n]
    std::vector<float> x, y, z;              // of finer cells' rays, not unit
  };
  static std::size_t which(glm::vec2 fine_shift) {
    return (fine_shift.x > .5f ? 1u : 0u) + (fine_shift.y > .5f ? 2u : 0u);
  }
  static OpenCells cells_below(const Tables& tables, const HemiOctFrame& frame);
  void add(const std::vector<float>& table, std::size_t cell, std::span<float> sum) const;
  float weight(const std::vector<float>& table, std::size_t cell) const;

  int bands_;
  std::size_t terms_;
  std::array<Tables, 4> tables_;
  std::array<float, VisibilityBake::kWideCells * VisibilityBake::kWideCells> wide_{};
};

}  // namespace penumbra::prt
