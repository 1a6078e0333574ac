// Rows of a depth camera's pictures, in vectors.
// threads: reentrant
#pragma once

#include <glm/mat3x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <span>

namespace penumbra::runtime {

/// A plane as seen by the depth camera: n . p + eye_m is the height of p in its frame.
struct SeenPlane {
  glm::vec3 normal;
  float eye_m;
};

/// Three rows of depth, of which the middle one counts, and where its pixels look.
struct DepthRow {
  std::span<const float> above, here, below, ray_x, ray_y;
};

/// `out` of what is higher over each plane than Foreground::margin_m, else 0. A pixel between two
/// depths that are more than 5 % apart belongs to the one that is nearer to its own.
void keep_in_front(const DepthRow& row, std::span<const SeenPlane> planes, std::span<float> out);

/// From points of the depth camera's frame to a pinhole's picture.
struct PinholePicture {
  glm::mat3 turn;
  glm::vec3 move;
  glm::vec2 focal_px, principal_px;
};

struct ProjectedRow {
  std::span<float> x_px, y_px, distance_m;
};

/// Where the pixels of row.here lie in the picture, and how far before it: 0 for what has no depth
/// or is behind the camera. The rows above and below are not read.
void project_row(const PinholePicture& view, const DepthRow& row, const ProjectedRow& out);

}  // namespace penumbra::runtime
