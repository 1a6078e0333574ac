// Calibration boards and their corners in pictures.
// threads: reentrant
#pragma once

#include <glm/vec2.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

struct Board {
  enum class Kind { kChessboard, kCharuco, kAprilTag };
  Kind kind = Kind::kChessboard;
  // Inner corners of a chessboard; squares of a ChArUco board; tags of an AprilTag grid
  int columns = 0, rows = 0;
  double square_m = 0;  // side of a square, of a tag for AprilTag
  double marker_m = 0;  // side of a ChArUco marker; gap between two AprilTags
  int first_id = 0;     // of the markers, so that two boards in one picture differ
};

/// How many markers a board has; 0 for a chessboard.
int marker_count(const Board& board);

/// "chessboard:15x9:0.026", "charuco:8x6:0.04:0.03" (4x4_50 markers), "apriltag:6x6:0.088:0.0264"
/// (36h11, ids row by row from 0). A fifth part is the first id: "charuco:8x6:0.04:0.03:24".
/// errors: kInvalid
Result<Board> parse_board(std::string_view text);

/// The corners of a board that one picture shows.
struct BoardView {
  std::string name;                    // of the picture
  std::vector<glm::dvec2> pixels;      // continuous
  std::vector<glm::dvec2> on_board_m;  // x to the right, y down, from the first corner
};

/// Nothing when the board is not there; of a board with markers a part is enough (six corners at
/// least).
std::optional<BoardView> find_board(const FramePixels& picture, const Board& board,
                                    std::string name);

}  // namespace penumbra::calib
#pragma GCC visibility pop
