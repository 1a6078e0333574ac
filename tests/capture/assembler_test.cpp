#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <glm/gtx/quaternion.hpp>
#include <random>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "core/half.h"

namespace penumbra::capture {
namespace {

using calib::ProjectionKind;
using glm::dvec3;

constexpr HalfRgba kOne{kHalfOne, kHalfOne, kHalfOne, kHalfOne};

calib::CameraModel projection(ProjectionKind kind, int width, int height) {
  const auto p = calib::make_projection(kind, width, height);
  EXPECT_TRUE(p);
  return p ? *p : calib::CameraModel{};
}

MergedImage constant(int width, int height, float scale) {
  MergedImage m;
  m.pixels = Image<HalfRgba>(width, height, kOne);
  m.scale = scale;
  return m;
}

float confidence_at(const Environment& e, int x, int y) {
  return e.confidence.empty() ? 1.f : e.confidence.at(x, y);
}

TEST(EnvironmentAssembler, ConstantRadianceStaysConstantWhereSeenAndIsZeroElsewhere) {
  std::mt19937 rng(1);
  std::normal_distribution<double> g;
  for (const ProjectionKind kind :
       {ProjectionKind::kEquidistant, ProjectionKind::kPinhole, ProjectionKind::kAngular,
        ProjectionKind::kMirrorBall, ProjectionKind::kLatLong}) {
    const int width = kind == ProjectionKind::kLatLong ? 128 : 96,
              height = kind == ProjectionKind::kLatLong ? 64 : 90;
    const auto p = projection(kind, width, height);
    for (int turn = 0; turn < 3; ++turn) {
      const Pose pose{turn == 0 ? glm::dquat(1, 0, 0, 0)
                                : glm::normalize(glm::dquat(g(rng), g(rng), g(rng), g(rng))),
                      {}};
      EnvironmentAssembler assembler(p, pose, 100, 50);
      Environment out;
      assembler.assemble(constant(width, height, 3.5f), out);
      int seen = 0;
      for (int y = 0; y < 50; ++y)
        for (int x = 0; x < 100; ++x) {
          const dvec3 d =
              glm::conjugate(pose.rotation) * latlong_direction(x + .5, y + .5, 100, 50);
          const bool looks = calib::pixel_from_direction(p, d).has_value();
          seen += looks;
          ASSERT_EQ(confidence_at(out, x, y), looks ? 1.f : 0.f)
              << calib::projection_name(kind) << x << ' ' << y;
          for (int c = 0; c < 3; ++c)
            ASSERT_NEAR(out.radiance.at(x, y)[c], looks ? 3.5f : 0.f, 1e-5f)
                << calib::projection_name(kind);
        }
      EXPECT_GT(seen, 100);
      EXPECT_NEAR(out.clipped_fraction, 0, 1e-6);
    }
  }
}

TEST(EnvironmentAssembler, LatLongOfTheSameSizeIsCopied) {
  std::mt19937 rng(2);
  std::uniform_real_distribution<float> value(-1, 5);
  for (const auto& [width, height] : {std::pair{64, 32}, {37, 19}, {16, 16}}) {
    MergedImage merged = constant(width, height, .25f);
    Image<Rgb> expected(width, height);
    for (std::size_t i = 0; i < expected.area(); ++i) {
      HalfRgba& p = merged.pixels.pixels()[i];
      p.r = half_from_float(value(rng)), p.g = half_from_float(value(rng)),
      p.b = half_from_float(value(rng));
      expected.pixels()[i] =
          .25f * Rgb{float_from_half(p.r), float_from_half(p.g), float_from_half(p.b)};
    }
    EnvironmentAssembler assembler(projection(ProjectionKind::kLatLong, width, height), {}, width,
                                   height);
    Environment out;
    assembler.assemble(merged, out);
    EXPECT_EQ(out.radiance, expected) << width << 'x' << height;
  }
}

/// Where the light of a picture comes from, weighted by solid angle.
dvec3 centroid(const Image<Rgb>& map) {
  dvec3 sum(0);
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      sum += latlong_direction(x + .5, y + .5, map.width(), map.height()) *
             (latlong_solid_angle(y, map.width(), map.height()) * map.at(x, y).g);
  return glm::normalize(sum);
}

/// A picture that is bright within 20 degrees of `axis` of the camera.
MergedImage patch(const calib::CameraModel& p, const dvec3& axis) {
  MergedImage merged = constant(p.width, p.height, 1);
  for (int y = 0; y < p.height; ++y)
    for (int x = 0; x < p.width; ++x) {
      const auto d = calib::direction_from_pixel(p, {x + .5, y + .5});
      if (!d || glm::dot(*d, axis) < std::cos(.35)) merged.pixels.at(x, y) = {0, 0, 0, kHalfOne};
    }
  return merged;
}

TEST(EnvironmentAssembler, PoseOfTheCameraMovesAPatchToItsWorldDirection) {
  const dvec3 axes[] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  for (const ProjectionKind kind :
       {ProjectionKind::kLatLong, ProjectionKind::kEquidistant, ProjectionKind::kPinhole,
        ProjectionKind::kAngular, ProjectionKind::kMirrorBall}) {
    const auto p = projection(kind, kind == ProjectionKind::kLatLong ? 256 : 160,
                              kind == ProjectionKind::kLatLong ? 128 : 160);
    // Off the optical axis, so that a mirrored picture would be seen.
    const dvec3 in_camera = glm::normalize(dvec3(.15, .1, -1));
    const MergedImage picture = patch(p, in_camera);
    for (const dvec3& axis : axes) {
      const Pose pose{glm::angleAxis(.3, axis) * glm::rotation(dvec3(0, 0, -1), axis), {4, 5, 6}};
      EnvironmentAssembler assembler(p, pose, 256, 128);
      Environment out;
      assembler.assemble(picture, out);
      EXPECT_GT(glm::dot(centroid(out.radiance), pose.rotation * in_camera), std::cos(.02))
          << calib::projection_name(kind) << " axis " << axis.x << ' ' << axis.y << ' ' << axis.z;
    }
  }
}

TEST(EnvironmentAssembler, ClippedPixelsCountByTheirSolidAngle) {
  const auto p = projection(ProjectionKind::kLatLong, 128, 64);
  MergedImage merged = constant(128, 64, 1);
  for (int y = 0; y < 8; ++y)  // a cap of 22.5 degrees
    for (HalfRgba& pixel : merged.pixels.row(y)) pixel.a = 0;
  const double cap = (1 - std::cos(kPi / 8)) / 2;
  for (const auto& [width, height] : {std::pair{128, 64}, {200, 100}}) {  // copied, and gathered
    EnvironmentAssembler assembler(p, {}, width, height);
    Environment out;
    assembler.assemble(merged, out);
    EXPECT_NEAR(out.clipped_fraction, cap, .03 * cap) << width;
  }
  // Turned upside down, the same part of the sphere is clipped.
  const Pose pose{glm::angleAxis(2.1, glm::normalize(dvec3(1, .2, .5))), {}};
  EnvironmentAssembler assembler(p, pose, 200, 100);
  Environment out;
  assembler.assemble(merged, out);
  EXPECT_NEAR(out.clipped_fraction, cap, .03 * cap);
}

TEST(EnvironmentAssembler, SecondPictureReplacesTheFirst) {
  const auto p = projection(ProjectionKind::kEquidistant, 80, 80);
  EnvironmentAssembler assembler(p, {}, 64, 32);
  Environment out, fresh;
  assembler.assemble(constant(80, 80, 9), out);
  assembler.assemble(constant(80, 80, 2), out);
  assembler.assemble(constant(80, 80, 2), fresh);
  EXPECT_EQ(out.radiance, fresh.radiance);
  EXPECT_EQ(out.clipped_fraction, fresh.clipped_fraction);
}

}  // namespace
}  // namespace penumbra::capture
