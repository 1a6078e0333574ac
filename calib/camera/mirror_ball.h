// A mirror ball before a camera: which light each ray of the camera shows, at any distance.
// threads: reentrant; plain values
#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <string>

#include "calib/camera/camera_model.h"
#include "core/pose.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Reflection of far light in a ball whose centre and radius are known in the frame of the camera,
/// which sits at the origin. Only the ratio of radius and distance matters.
/// source: law of reflection. With the normal at the angle t from the line to the camera and the
/// ray at b(t) from that line, light comes from 2 t + b, which grows with t
class MirrorBall {
 public:
  /// errors: kInvalid (not finite, no radius, the camera inside)
  static Result<MirrorBall> at(const glm::dvec3& centre, double radius);
  /// From its outline in a picture, given as a circle.
  /// errors: kInvalid (the circle leaves what the camera sees)
  static Result<MirrorBall> from_outline(const CameraModel& camera, const glm::dvec2& centre_px,
                                         double radius_px);

  const glm::dvec3& direction() const { return axis_; }  // unit, from the camera to the centre
  double angular_radius_rad() const;

  struct BallHit {
    glm::dvec3 ray;  // unit
    // 1 in the middle, 0 on the outline: fraction of the normal's angle that is left
    double from_rim;
  };
  /// The ray that shows the light of a direction; nothing for light from behind the ball, which
  /// grazes it.
  std::optional<BallHit> ray_from_light(const glm::dvec3& light) const;

 private:
  MirrorBall(const glm::dvec3& axis, double ratio) : axis_(axis), ratio_(ratio) {}
  glm::dvec3 axis_;
  double ratio_;  // radius / distance
};

/// A ball's outline in the picture of a camera that stands, as someone laid a circle over it.
struct BallOutline {
  std::string camera;  // names it in errors
  CameraModel projection;
  Pose world_from_camera;
  glm::dvec2 centre_px;
  double radius_px = 0;
};
struct BallPlace {
  glm::dvec3 centre_m, sigma_m;  // in the world; one standard deviation along each axis
};
/// Where a ball of known radius stands: each outline tells its direction and, less well, its
/// distance.
/// sigma_px: of the outlines' centres and radii
/// errors: kInvalid (no outline, as MirrorBall::from_outline), kUndetermined (outlines that
/// contradict each other)
Result<BallPlace> locate_ball(std::span<const BallOutline> outlines, double radius_m,
                              double sigma_px = 1);

}  // namespace penumbra::calib
#pragma GCC visibility pop
