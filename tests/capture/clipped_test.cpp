// Where a source is clipped in every exposure, the environment says so, pixel by pixel.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "core/half.h"

namespace penumbra::capture {
namespace {

constexpr HalfRgba kWhite{kHalfOne, kHalfOne, kHalfOne, kHalfOne};
constexpr HalfRgba kClipped{kHalfOne, kHalfOne, kHalfOne, 0};

calib::CameraModel latlong(int width, int height) {
  const auto p = calib::make_projection(calib::ProjectionKind::kLatLong, width, height);
  EXPECT_TRUE(p);
  return *p;
}

MergedImage merged_with(int width, int height, std::initializer_list<std::uint32_t> clipped) {
  MergedImage merged;
  merged.pixels = Image<HalfRgba>(width, height, kWhite);
  for (const std::uint32_t i : clipped) merged.pixels.pixels()[i] = kClipped;
  return merged;
}

TEST(ClippedPixels, AreThoseOfACopiedSource) {
  EnvironmentAssembler assembler(latlong(64, 32), {}, 64, 32);
  Environment out;
  assembler.assemble(merged_with(64, 32, {0, 63, 64, 700, 2047}), out);
  EXPECT_EQ(out.clipped, (std::vector<std::uint32_t>{0, 63, 64, 700, 2047}));
  EXPECT_GT(out.clipped_fraction, 0);
}

TEST(ClippedPixels, OfAnOldPictureAreForgottenAndTheListKeepsItsMemory) {
  EnvironmentAssembler assembler(latlong(64, 32), {}, 64, 32);
  Environment out;
  assembler.assemble(merged_with(64, 32, {10, 11, 12}), out);
  const auto* const before = out.clipped.data();
  assembler.assemble(merged_with(64, 32, {}), out);
  EXPECT_TRUE(out.clipped.empty());
  EXPECT_EQ(out.clipped_fraction, 0);
  assembler.assemble(merged_with(64, 32, {5, 6}), out);
  EXPECT_EQ(out.clipped.size(), 2U);
  EXPECT_EQ(out.clipped.data(), before);
}

TEST(ClippedPixels, AreThoseThatAClippedSampleTookPartIn) {
  const auto p = latlong(256, 128);
  const Pose pose{glm::angleAxis(2.1, glm::normalize(glm::dvec3(1, .2, .5))), {}};
  EnvironmentAssembler assembler(p, pose, 256, 128);
  for (const std::uint32_t at : {256U * 30 + 7, 256U * 64 + 100, 256U * 90 + 200}) {
    Environment out;
    MergedImage merged = merged_with(256, 128, {at});
    merged.pixels.pixels()[at] = {0, 0, 0, 0};  // a hole in an even picture shows who used it
    assembler.assemble(merged, out);
    std::vector<std::uint32_t> darker;
    for (std::uint32_t i = 0; i < out.radiance.area(); ++i)
      if (out.radiance.pixels()[i].g < 1 - 1e-6f) darker.push_back(i);
    EXPECT_FALSE(out.clipped.empty());
    EXPECT_TRUE(std::ranges::includes(out.clipped, darker)) << at;
    EXPECT_LE(out.clipped.size(), darker.size() + 1);
    for (const std::uint32_t i : out.clipped) {
      const glm::dvec3 d =
          pose.rotation * latlong_direction(at % 256 + .5, at / 256 + .5, 256, 128);
      EXPECT_LT(std::acos(glm::dot(d, latlong_direction(i % 256 + .5, i / 256 + .5, 256, 128))),
                .06);
    }
  }
}

TEST(ClippedPixels, WhatACameraDoesNotSeeIsNotClipped) {
  const auto p = calib::make_projection(calib::ProjectionKind::kPinhole, 96, 90);
  ASSERT_TRUE(p);
  EnvironmentAssembler assembler(*p, {}, 128, 64);
  Environment out;
  assembler.assemble(merged_with(96, 90, {}), out);
  EXPECT_FALSE(out.confidence.empty());
  EXPECT_TRUE(out.clipped.empty());
}

// The same picture through tables, and through the merge of 16 bit frames.
class ClippedDisc : public testing::TestWithParam<int> {};

TEST_P(ClippedDisc, IsListedAndNothingElse) {
  const Image<Rgb> sky = make_sky_environment(256, 128, .7);
  CameraInfo camera;
  camera.name = "sky";
  camera.projection = latlong(256, 128);
  Sensor sensor;
  sensor.bits = GetParam();
  HdrRing ring(camera, 2);
  Result<const MergedImage*> merged = nullptr;
  std::uint64_t number = 0;
  for (const double seconds : {.4, .1}) {  // the shortest is clipped from 10 on; the sky ends at 2
    auto pixels = std::make_shared<FramePixels>();
    expose(sensor, sky, {Seconds(seconds), Gain(1)}, number, *pixels);
    merged = ring.add(
        {0, number, {static_cast<std::int64_t>(number)}, {Seconds(seconds), Gain(1)}, {}, pixels});
    ASSERT_TRUE(merged);
    ++number;
  }
  EnvironmentAssembler assembler(camera.projection, {}, 256, 128);
  Environment out;
  assembler.assemble(**merged, out);
  std::vector<std::uint32_t> expected;
  for (std::uint32_t i = 0; i < sky.area(); ++i)
    if (std::max({sky.pixels()[i].r, sky.pixels()[i].g, sky.pixels()[i].b}) > 9)
      expected.push_back(i);
  EXPECT_FALSE(expected.empty());
  EXPECT_EQ(out.clipped, expected);
}

INSTANTIATE_TEST_SUITE_P(Bits, ClippedDisc, testing::Values(8, 16));

}  // namespace
}  // namespace penumbra::capture
