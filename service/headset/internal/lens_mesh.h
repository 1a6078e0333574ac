// A camera's picture as triangles that know where each of their corners looks.
// threads: reentrant
#pragma once

#include <vector>

#include "calib/camera/camera_model.h"

namespace penumbra::service {

/// As it lies in a vertex buffer.
struct LensVertex {
  float direction[3];  // in the camera's frame, of any length
  float place[2];      // in the picture, 0..1 from its top left corner
};

/// Three vertices a triangle. Cells of the picture of at most 1/48 of its longer side are divided
/// where the lens bends more than a twentieth of a pixel, and along the border of what it shows.
std::vector<LensVertex> make_lens_mesh(const calib::CameraModel& camera);

}  // namespace penumbra::service
