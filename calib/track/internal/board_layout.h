// Private to track: what stands where on a board.
// threads: plain values
#pragma once

#include <array>
#include <glm/vec2.hpp>
#include <vector>

#include "calib/estimate/boards.h"

namespace penumbra::calib {

/// Metres, x right and y down from the board's first corner, as BoardView has them.
struct BoardLayout {
  struct Marking {
    int id;
    glm::dvec2 at_m;          // its upper left corner
    std::vector<bool> black;  // cells row by row, with the black border
  };
  struct Corner {  // a corner that is found to sub-pixels
    glm::dvec2 at_m;
    std::array<bool, 4> black;  // what is around: left above, right above, left below, right below
  };
  struct Rectangle {
    glm::dvec2 at_m, size_m;
  };
  std::vector<Marking> markers;
  std::vector<Corner> points;
  double marker_m = 0;             // side of a marker
  int cells = 0;                   // of a marker's side
  double clear_m = 0;              // around a point nothing else is this near
  std::vector<Rectangle> squares;  // black ones
  Rectangle outline{};             // of all that is black
};

BoardLayout layout_of(const Board& board);

/// All black as rectangles that do not overlap: squares, and runs of cells.
std::vector<BoardLayout::Rectangle> black_of(const BoardLayout& layout);

}  // namespace penumbra::calib
