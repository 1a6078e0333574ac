// What each pixel of a camera sees of the sphere.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>
#include <vector>

#include "calib/camera/camera_model.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// Per pixel: unit direction through its centre, exact solid angle, confidence 0..1 (0 = not seen).
/// A pixel partly outside the sphere's image counts only its part within. The solid angles of a
/// whole-sphere projection sum to 4 pi within 1e-6.
/// source: central radial lens r(th): dw/dA = sin th/(r r'); mirror ball 4/R^2; plane element of a
///         cube
struct ProjectionTable {
  int width = 0, height = 0;
  std::vector<glm::vec3> direction;
  std::vector<float> solid_angle_sr;
  std::vector<float> confidence;
};
ProjectionTable make_projection_table(const CameraModel& projection);

}  // namespace penumbra::calib
#pragma GCC visibility pop
