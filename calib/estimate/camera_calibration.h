// A camera's intrinsics from pictures of a board.
// source: Zhang 2000 (planes), Kannala & Brandt 2006, Usenko et al. 2018; robust loss Huber 1964
// threads: reentrant
#pragma once

#include <span>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/estimate/boards.h"
#include "core/pose.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// What became of one picture's board.
struct BoardFit {
  std::string name;
  double rms_px = 0;                     // of the distance between corner and prediction
  bool used = true;                      // false: its corners contradict all the others
  Pose camera_from_board;                // board: x right, y up, z towards who looks at it
  std::vector<glm::dvec2> residuals_px;  // found minus predicted
};

struct CameraCalibration {
  CameraModel projection;
  glm::dvec2 focal_sigma_px{0, 0}, principal_sigma_px{0, 0};  // one standard deviation
  std::array<double, 5> distortion_sigma{};
  /// Of focal_px, principal_px and the distortion's terms, row by row, on all of which it counts.
  std::vector<double> covariance;
  std::array<bool, 5> distortion_fixed{};  // terms at 0, which the pictures do not determine
  double rms_px = 0;                       // over the boards used
  std::vector<BoardFit> boards;
  double reach = 0;     // largest distance of a corner from the middle, in half diagonals
  double coverage = 0;  // part of an 8 x 6 grid over the picture with a corner in each cell
};

/// kind: pinhole, equidistant, kb4 or double-sphere. Needs corners that reach outwards and boards
/// that are tilted; boards whose corners contradict the rest are left out and named. Terms of the
/// distortion that would fold the lens back within 30 degrees are left out, the highest first,
/// where the rest fits as well.
/// errors: kInvalid (kind), kUndetermined (says what to capture instead)
Result<CameraCalibration> calibrate_camera(std::span<const BoardView> views, ProjectionKind kind,
                                           int width, int height);

}  // namespace penumbra::calib
#pragma GCC visibility pop
