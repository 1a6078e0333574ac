// Projections of every kind, for the tests of this folder.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "calib/calib.h"
#include "core/conventions.h"

namespace penumbra::calib {

using enum ProjectionKind;

inline CameraModel projection(ProjectionKind kind, int width, int height) {
  const auto p = make_projection(kind, width, height);
  EXPECT_TRUE(p.has_value()) << projection_name(kind);
  return p.value_or(CameraModel{});
}

/// The default equidistant camera reaches the whole sphere once the focal length is short enough.
inline CameraModel whole_equidistant(int size) {
  CameraModel p = projection(kEquidistant, size, size);
  p.focal_px = glm::dvec2(size / (2 * kPi));
  return p;
}

inline std::vector<CameraModel> whole_spheres(int scale) {
  return {projection(kLatLong, 4 * scale, 2 * scale),
          projection(kAngular, 3 * scale, 3 * scale),
          projection(kAngular, 3 * scale + 1, 4 * scale),
          projection(kMirrorBall, 3 * scale, 3 * scale),
          projection(kMirrorBall, 5 * scale, 3 * scale + 1),
          whole_equidistant(3 * scale),
          projection(kVerticalCross, 3 * scale, 4 * scale),
          projection(kExrLatLong, 4 * scale, 2 * scale),
          projection(kExrCube, scale + 1, 6 * (scale + 1))};
}

inline std::vector<CameraModel> all_kinds() {
  auto all = whole_spheres(64);
  all.push_back(projection(kEquidistant, 320, 240));
  all.push_back(projection(kPinhole, 320, 240));
  return all;
}

inline std::string name_of(const CameraModel& p) {
  return std::string(projection_name(p.kind)) + " " + std::to_string(p.width) + "x" +
         std::to_string(p.height);
}

}  // namespace penumbra::calib
