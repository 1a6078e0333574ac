// A pinhole camera and where it stands.
// threads: plain values
#pragma once

#include <glm/vec2.hpp>

#include "core/pose.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct PinholeView {
  int width = 0, height = 0;
  glm::dvec2 focal_px{0, 0}, principal_px{0, 0};
  Pose world_from_camera;
  friend bool operator==(const PinholeView&, const PinholeView&) = default;
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
