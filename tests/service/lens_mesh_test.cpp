// The mesh of a lens against the lens itself, between its corners and along its border.
#include "service/headset/internal/lens_mesh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "core/conventions.h"

namespace penumbra::service {
namespace {

using calib::CameraModel;
using calib::ProjectionKind;

CameraModel lens(ProjectionKind kind, int width, int height, glm::dvec2 focal_px,
                 std::vector<double> distortion = {}) {
  CameraModel out = *calib::make_projection(kind, width, height);
  if (calib::has_intrinsics(kind)) out.focal_px = focal_px;
  return *calib::with_distortion(out, distortion);
}

glm::dvec3 direction_of(const LensVertex& v) {
  return {v.direction[0], v.direction[1], v.direction[2]};
}

struct MeshErrors {
  double largest_px = 0;  // in the middle of triangles
  double seen = 0;        // area of the triangles, as a part of the picture
};

MeshErrors errors_of(const CameraModel& camera) {
  const std::vector<LensVertex> mesh = make_lens_mesh(camera);
  EXPECT_EQ(mesh.size() % 3, 0u);
  const auto place = [&](const LensVertex& v) {
    return glm::dvec2(v.place[0] * camera.width, v.place[1] * camera.height);
  };
  MeshErrors out;
  for (std::size_t i = 0; i + 2 < mesh.size(); i += 3) {
    const LensVertex &a = mesh[i], &b = mesh[i + 1], &c = mesh[i + 2];
    const glm::dvec2 p = place(b) - place(a), q = place(c) - place(a);
    out.seen += std::abs(p.x * q.y - p.y * q.x) / 2;
    const auto at = calib::pixel_from_direction(
        camera, (direction_of(a) + direction_of(b) + direction_of(c)) / 3.);
    if (!at) continue;  // beyond the rim by a rounding
    const glm::dvec2 off = *at - (place(a) + place(b) + place(c)) / 3.;
    out.largest_px = std::max(out.largest_px, glm::length(off));
  }
  out.seen /= static_cast<double>(camera.width) * camera.height;
  return out;
}

TEST(LensMesh, APinholeIsExact) {
  const MeshErrors e = errors_of(lens(ProjectionKind::kPinhole, 1920, 1080, {1100, 1090}));
  EXPECT_LT(e.largest_px, .001);
  EXPECT_NEAR(e.seen, 1, 1e-6);
}

TEST(LensMesh, ALensWithDistortionIsMetWithinATwentiethOfAPixel) {
  const MeshErrors pinhole =
      errors_of(lens(ProjectionKind::kPinhole, 1280, 720, {900, 900}, {-.28, .07, .0002, .00002}));
  EXPECT_LT(pinhole.largest_px, .05);
  EXPECT_GT(pinhole.seen, .999);
  const MeshErrors index =
      errors_of(lens(ProjectionKind::kKannalaBrandt, 960, 960, {412, 412}, {.19, .03, -.12, .04}));
  EXPECT_LT(index.largest_px, .05);
  EXPECT_GT(index.seen, .7) << "as much as the lens shows before it folds back";
}

TEST(LensMesh, AFisheyesRoundPictureIsMetUpToItsRim) {
  // All of the sphere within a circle of 300 pixels; its rim is a single direction.
  const double focal_px = 300 / kPi;
  const MeshErrors e =
      errors_of(lens(ProjectionKind::kEquidistant, 640, 640, {focal_px, focal_px}));
  const double circle = kPi * 300 * 300 / (640. * 640);
  EXPECT_LT(e.seen, circle);
  EXPECT_GT(e.seen, .99 * circle);
  EXPECT_LT(e.largest_px, .3) << "near the rim, where the picture turns fast";
  EXPECT_LT(
      errors_of(lens(ProjectionKind::kDoubleSphere, 512, 512, {157, 157}, {-.21, .58})).largest_px,
      .05);
}

TEST(LensMesh, WholeSpheresHaveNoTrianglesAcrossTheirSeams) {
  for (const auto& [kind, width, height] : {std::tuple(ProjectionKind::kLatLong, 1024, 512),
                                            std::tuple(ProjectionKind::kVerticalCross, 768, 1024),
                                            std::tuple(ProjectionKind::kExrCube, 128, 768)}) {
    const CameraModel camera = lens(kind, width, height, {});
    const std::vector<LensVertex> mesh = make_lens_mesh(camera);
    for (std::size_t i = 0; i + 2 < mesh.size(); i += 3)
      for (std::size_t j = 0; j < 3; ++j)
        ASSERT_GT(glm::dot(glm::normalize(direction_of(mesh[i + j])),
                           glm::normalize(direction_of(mesh[i + (j + 1) % 3]))),
                  .8)
            << calib::projection_name(kind);
    const double whole = kind == ProjectionKind::kVerticalCross ? .5 : 1;
    EXPECT_GT(errors_of(camera).seen, .9 * whole) << calib::projection_name(kind);
  }
}

}  // namespace
}  // namespace penumbra::service
