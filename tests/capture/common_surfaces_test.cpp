#include "calib/calib.h"
#include "capture/capture.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/conventions.h"
#include "tests/support/brackets.h"

namespace penumbra::capture {
namespace {

const glm::dmat3 kMatrix =
    glm::transpose(glm::dmat3(1.9, -.25, .05, -.12, 1.4, -.2, .02, -.35, 2.1));

Rgb light_from(const glm::dvec3& d) {
  const auto wave = [](double x) { return .4 + .35 * std::sin(x); };
  return {static_cast<float>(wave(5 * d.x + 2 * d.y)), static_cast<float>(wave(4 * d.y - 3 * d.z)),
          static_cast<float>(wave(6 * d.z + d.x + 1))};
}

// What a camera of its own colours sees of far surroundings.
StillPicture picture(CameraInfo camera, const glm::dmat3& own_from_light) {
  const calib::CameraModel& p = camera.projection;
  StillPicture out{camera, Image<Rgb>(p.width, p.height), Image<std::uint8_t>(p.width, p.height)};
  for (int y = 0; y < p.height; ++y)
    for (int x = 0; x < p.width; ++x) {
      const auto d = calib::direction_from_pixel(p, {x + .5, y + .5});
      if (!d) continue;
      const Rgb l = light_from(camera.world_from_camera.rotation * *d);
      const glm::dvec3 v = own_from_light * glm::dvec3(l.r, l.g, l.b);
      out.radiance.at(x, y) = {static_cast<float>(v.x), static_cast<float>(v.y),
                               static_cast<float>(v.z)};
    }
  return out;
}

CameraInfo camera(calib::ProjectionKind kind, int width, int height, const Pose& pose) {
  CameraInfo c;
  c.projection = *calib::make_projection(kind, width, height);
  c.world_from_camera = pose;
  return c;
}

struct Rig {
  StillPicture environment, view;
};
Rig rig() {
  const CameraInfo fisheye =
      camera(calib::ProjectionKind::kEquidistant, 500, 500, look_at({0, 1, 0}, {0, 9, 1}));
  const CameraInfo pinhole =
      camera(calib::ProjectionKind::kPinhole, 640, 360, look_at({0, 1, 2}, {1, 2, 0}));
  return {picture(fisheye, glm::inverse(kMatrix)), picture(pinhole, glm::dmat3(1))};
}

TEST(CommonSurfaces, TellHowColoursGoFromOneCameraToTheOther) {
  const Rig both = rig();
  std::vector<calib::ColourPair> pairs;
  for (const CommonSurface& s : common_surfaces(both.environment, both.view))
    pairs.push_back(s.colours);
  EXPECT_GT(pairs.size(), 300u);
  const auto found = calib::calibrate_colour(pairs, calib::ColourModel::kMatrix);
  ASSERT_TRUE(found) << found.error().detail;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) EXPECT_NEAR(found->matrix[c][r], kMatrix[c][r], .02);
}

TEST(CommonSurfaces, WhatClipsInEitherPictureOrIsSeenByOneAloneIsLeftOut) {
  Rig both = rig();
  for (int y = 0; y < both.view.clipped.height(); ++y)
    for (int x = 0; x < both.view.clipped.width() / 2; ++x) both.view.clipped.at(x, y) = 1;
  const auto right = common_surfaces(both.environment, both.view);
  EXPECT_GT(right.size(), 100u);
  for (const CommonSurface& s : right) EXPECT_GT(s.at_px.x, 320);
  both.view.camera.world_from_camera = look_at({0, 1, 0}, {0, -9, 1});
  EXPECT_TRUE(common_surfaces(both.environment, both.view).empty()) << "below the fisheye's rim";
}

TEST(Assembler, CarriesTheCamerasColours) {
  MergedImage merged;
  merged.pixels = Image<HalfRgba>(
      64, 32,
      {half_from_float(.5f), half_from_float(.25f), half_from_float(2), half_from_float(1)});
  const auto projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 64, 32);
  EnvironmentAssembler assembler(projection, {}, 64, 32, kMatrix);
  Environment out;
  for (int twice = 0; twice < 2; ++twice) {  // a second frame is carried once
    assembler.assemble(merged, out);
    const glm::dvec3 expected = kMatrix * glm::dvec3(.5, .25, 2);
    for (const Rgb& p : out.radiance.pixels())
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(double(p[c]), expected[c], 1e-5);
  }
}

}  // namespace
}  // namespace penumbra::capture
