// The ways in which a camera shows its surroundings: its whole picture, parts of it behind lenses
// of their own (a 360-degree camera), or a mirror ball that stands in it.
// threads: reentrant
#pragma once

#include <array>
#include <functional>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "calib/camera/camera_model.h"
#include "capture/frames.h"
#include "core/pose.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

struct PixelHit {
  glm::dvec2 px;          // continuous, in the part
  double from_rim = 1;    // 1 in the middle, 0 where the part or what the lens sees ends
  double light_left = 1;  // by the lens's vignetting
};
/// Where a direction of the camera's frame is seen; nothing where it is not.
using PixelLookup = std::function<std::optional<PixelHit>(const glm::dvec3& direction)>;

/// A part of a camera's picture.
struct CameraRegion {
  int x_px = 0, y_px = 0, width = 0, height = 0;
  int rows = 0;  // of a lat-long map that resolves as much as the middle of the part
  PixelLookup find_pixel;
  std::optional<calib::CameraModel> projection;  // of the part; nothing for a ball
  glm::dquat camera_from_part{1, 0, 0, 0};
  bool vignetted = false;
};

/// The whole picture of a camera with this projection.
CameraRegion plain_region(const calib::CameraModel& projection,
                          const std::array<double, 3>& vignetting = {});

/// Whether light can be measured with it.
bool shows_surroundings(const CameraInfo& camera);

/// All regions of a camera that shows_surroundings(). A ball that has its place in the world is
/// looked for from `world_from_camera`.
/// errors: kInvalid (fewer than two pixels a side), kUndetermined (the ball is not in the picture)
Result<std::vector<CameraRegion>> camera_regions(const CameraInfo& camera,
                                                 const Pose& world_from_camera);

/// Where in the whole picture a direction of the camera's frame is seen: of several regions, in the
/// one whose rim is farthest from it.
std::optional<glm::dvec2> find_in_picture(std::span<const CameraRegion> regions,
                                          const glm::dvec3& direction);

/// That part of a picture alone.
FramePixels cut_out(const FramePixels& picture, const CameraRegion& part);

}  // namespace penumbra::capture
#pragma GCC visibility pop
