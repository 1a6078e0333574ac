// Private to track: a camera's pose from points of known places, robustly.
// source: Levenberg 1944, Marquardt 1963; weights of Beaton & Tukey 1974
// threads: reentrant
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/track/internal/matrix6.h"
#include "core/pose.h"

namespace penumbra::calib {

/// A point, the direction in which it is seen, and what a change of direction moves its pixel by.
struct Sighting {
  glm::dvec3 in_world, seen;
  std::array<glm::dvec3, 2> pixels;  // of x and y, per unit of direction
};
/// Nothing where the lens does not tell.
std::optional<Sighting> sighting_of(const CameraModel& lens, glm::dvec2 pixel,
                                    const glm::dvec3& in_world);

struct SolvedPose {
  Pose world_from_camera;
  Matrix6 covariance;          // turn about the world's axes (rad), then position (m)
  double rms_px = 0;           // of a coordinate, of the points that count
  double sigma_px = 0;         // scale of the weights
  int used = 0;                // points that count
  std::vector<double> off_px;  // of each point
};

/// Nothing with fewer than four points, or where they leave the pose open.
std::optional<SolvedPose> solve_pose(std::span<const Sighting> points, const Pose& start);

/// Sum of what the points are off by, squared, in standard deviations; none counts beyond five.
double misfit(const SolvedPose& pose, double sigma_px);

/// The other pose from which a flat board looks nearly the same: it leans the other way.
/// source: Schweighofer & Pinz 2006; here as the mirror image of a distant board
Pose leaned_the_other_way(const Pose& world_from_camera, const glm::dvec3& middle,
                          const glm::dmat3& world_from_board);

/// Of a flat board from its middle's direction, as a pinhole would see it that looks there.
/// on_board: metres, x right and y down
/// source: Collins & Bartoli 2014, by OpenCV
std::optional<Pose> flat_board_pose(std::span<const glm::dvec3> seen,
                                    std::span<const glm::dvec2> on_board);

}  // namespace penumbra::calib
