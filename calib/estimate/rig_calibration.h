// Estimation of where the cameras of a rig stand, from a board that several of them see at once.
// source: bundle adjustment, Triggs et al. 2000; hand-eye start, Park & Martin 1994; time offset,
// Furgale et al. 2013
// threads: reentrant
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/estimate/boards.h"
#include "core/pose.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

struct RigCameraInput {
  std::string name;
  CameraModel projection;  // as calibrate_camera() found it
  /// CameraCalibration::covariance; empty: the lens is taken as exact.
  std::vector<double> lens_covariance{};
};

struct RigObservation {
  std::size_t camera = 0;
  double time_s = 0;
  BoardView view;
};

/// Of a body that the cameras are fixed to.
struct TrackerPose {
  double time_s = 0;
  Pose world_from_body;
};

struct RigOptions {
  std::vector<TrackerPose> tracker;  // by time; empty: none
  double tracker_sigma_m = .001, tracker_sigma_rad = .001;
  double max_offset_s = .5;        // of the tracker's clock
  double max_time_apart_s = .005;  // frames closer than this show one moment
};

struct RigCameraPose {
  Pose rig_from_camera;
  // One standard deviation, in the rig's axes
  glm::dvec3 position_sigma_m{0}, rotation_sigma_rad{0};
  double rms_px = 0;
  std::size_t boards = 0;
};

struct RigCalibration {
  std::vector<RigCameraPose> cameras;
  struct BoardAt {
    double time_s;
    Pose rig_from_board;  // the board's axes: x right, y up, z towards who looks at it
  };
  std::vector<BoardAt> rig_from_board;  // at each moment that counted
  // a frame of camera time t was taken at t + offset of the tracker's
  std::optional<double> tracker_offset_s;
  double tracker_offset_sigma_s = 0;
  // With a tracker: the board's size in its metres, over the told one
  std::optional<double> board_scale;
  double board_scale_sigma = 0;
  double rms_px = 0;
  std::vector<std::string> left_out;  // boards whose corners contradict the rest
};

/// The rig's frame is the first camera's; with tracker poses it is the tracked body, and the board
/// must stand still. Without, the board or the rig may move. Stated uncertainties hold what corners
/// and tracker leave open and what the lenses' own uncertainty moves.
/// errors: kInvalid (no camera, a lens covariance of another size, a tracker's times out of order),
///         kNonFinite, kUndetermined (a camera that never sees the board together with the others,
///         a rig that turns about one axis alone or too slowly, boards or a tracker that contradict
///         the rest, a board of another size by the tracker; says what to capture instead)
Result<RigCalibration> calibrate_rig(std::span<const RigCameraInput> cameras,
                                     std::span<const RigObservation> observations,
                                     const RigOptions& options = {});

/// A board's pose in front of a known camera; nothing where its corners fit none.
std::optional<Pose> board_pose(const CameraModel& projection, const BoardView& view);

}  // namespace penumbra::calib
#pragma GCC visibility pop
