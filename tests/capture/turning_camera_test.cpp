// A bracket whose frames were taken with the camera turned otherwise each time.
#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "calib/calib.h"
#include "capture/capture.h"
#include "capture/hdr/pose_warp.h"
#include "core/conventions.h"
#include "core/half.h"

namespace penumbra::capture {
namespace {

using glm::dvec3;

constexpr int kSide = 240;
const std::vector<Exposure> kSchedule = {
    {Seconds(.02), Gain(1)}, {Seconds(.005), Gain(1)}, {Seconds(.00125), Gain(1)}};

calib::CameraModel fisheye() {
  calib::CameraModel p = *calib::make_projection(calib::ProjectionKind::kEquidistant, kSide, kSide);
  p.focal_px = glm::dvec2(82);
  return p;
}

// The built-in room at mean luminance 60, as the camera sees it.
Image<Rgb> seen_from(const glm::dquat& world_from_camera) {
  static const Image<Rgb> room = [] {
    Image<Rgb> map = make_room_environment(1024, 512);
    double sum = 0, weight = 0;
    for (int y = 0; y < 512; ++y)
      for (int x = 0; x < 1024; ++x) {
        const double w = latlong_solid_angle(y, 1024, 512);
        sum += w * luminance(map.at(x, y)), weight += w;
      }
    for (Rgb& p : map.pixels()) p = p * static_cast<float>(60 * weight / sum);
    return map;
  }();
  Image<Rgb> out(kSide, kSide);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x) {
      Rgb sum{};
      for (int s = 0; s < 4; ++s) {
        const auto d =
            calib::direction_from_pixel(fisheye(), {x + (s % 2 + .5) / 2, y + (s / 2 + .5) / 2});
        if (!d) continue;
        const glm::dvec2 px = latlong_pixel(world_from_camera * *d, 1024, 512);
        sum +=
            room.at(std::min(static_cast<int>(px.x), 1023), std::min(static_cast<int>(px.y), 511));
      }
      out.at(x, y) = sum * (1.f / 4);
    }
  return out;
}

CameraInfo camera() {
  CameraInfo info;
  info.name = "head";
  info.projection = fisheye();
  info.response = calib::Response::srgb();
  return info;
}

struct Outcome {
  double worst_total = 0;  // light of the picture, relative error
  double rmse = 0;         // of the last picture, relative, over what is not dark
};

// `degrees` a frame about an axis aslant; poses told or not.
Outcome turn(double degrees, bool told, int bits) {
  Sensor sensor;
  sensor.response = camera().response;
  sensor.bits = bits;
  HdrRing ring(camera(), 8);
  Outcome out;
  glm::dquat pose(1, 0, 0, 0);
  const glm::dquat step = glm::angleAxis(degrees / 180 * kPi, glm::normalize(dvec3(.3, 1, .2)));
  for (std::size_t i = 0; i < 12; ++i, pose = glm::normalize(step * pose)) {
    const Image<Rgb> truth = seen_from(pose);
    Frame frame;
    frame.sequence = i;
    frame.time = TimestampNs{static_cast<std::int64_t>(i) * 16'666'667};
    frame.exposure = kSchedule[i % kSchedule.size()];
    if (told) frame.world_from_camera.rotation = pose;
    FramePixels pixels = bits == 8 ? FramePixels(Image<Rgb8>(kSide, kSide))
                                   : FramePixels(Image<Rgb16>(kSide, kSide));
    expose(sensor, truth, frame.exposure, i, pixels);
    frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    const auto merged = ring.add(frame);
    EXPECT_TRUE(merged);
    if (i < kSchedule.size() || !merged) continue;
    double light = 0, expected = 0, squares = 0, count = 0;
    for (std::size_t k = 0; k < truth.area(); ++k) {
      const double t = double(truth.pixels()[k].g),
                   m = double((*merged)->scale) *
                       double(float_from_half((*merged)->pixels.pixels()[k].g));
      light += m, expected += t;
      if (t < 10) continue;
      squares += std::pow(std::min(std::abs(m / t - 1), 1.), 2), ++count;
    }
    out.worst_total = std::max(out.worst_total, std::abs(light / expected - 1));
    out.rmse = std::sqrt(squares / count);
  }
  return out;
}

TEST(TurningCamera, KeepsTheLightOfAWholeBracketWhenItsPosesAreTold) {
  for (const double degrees : {.3, 1., 4.}) {
    const Outcome ours = turn(degrees, true, 8), plain = turn(degrees, false, 8);
    std::printf(
        "%.1f degrees a frame: total light off by %.2f %% (poses not told %.2f %%), RMSE %.2f %% "
        "(%.2f %%)\n",
        degrees, 100 * ours.worst_total, 100 * plain.worst_total, 100 * ours.rmse,
        100 * plain.rmse);
    EXPECT_LT(ours.worst_total, .01) << degrees;
    EXPECT_LT(ours.rmse, plain.rmse) << degrees;
  }
}

TEST(TurningCamera, SixteenBitsToo) {
  const Outcome ours = turn(1, true, 16), plain = turn(1, false, 16);
  std::printf("16 bits: %.2f %% (%.2f %%), RMSE %.2f %% (%.2f %%)\n", 100 * ours.worst_total,
              100 * plain.worst_total, 100 * ours.rmse, 100 * plain.rmse);
  EXPECT_LT(ours.worst_total, .02);
}

TEST(TurningCamera, APictureTurnedAndTurnedBackIsWithinAPixelAndSaysWhatItMissed) {
  Image<Rgb> picture(kSide, kSide);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x)
      picture.at(x, y) = {static_cast<float>(x), static_cast<float>(y), 1};
  const glm::dquat before_from_now = glm::angleAxis(.2, glm::normalize(dvec3(1, 2, -1)));
  Image<std::uint8_t> valid;
  const auto out = turned(FramePixels(picture), fisheye(), {}, before_from_now, valid);
  int checked = 0, missed = 0;
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x) {
      const auto d = calib::direction_from_pixel(fisheye(), {x + .5, y + .5});
      const auto expected =
          d ? calib::pixel_from_direction(fisheye(), before_from_now * *d) : std::nullopt;
      if (!expected) {
        missed += valid.at(x, y) == 0;
        continue;
      }
      ++checked;
      const Rgb& got = std::get<Image<Rgb>>(*out).at(x, y);
      ASSERT_NEAR(got.r + .5, expected->x, .61) << x << ' ' << y;
      ASSERT_NEAR(got.g + .5, expected->y, .61) << x << ' ' << y;
    }
  EXPECT_GT(checked, kSide * kSide / 2);
  EXPECT_GT(missed, 100);
}

// A lamp that the newest, longest exposure saturates where no shorter one has looked yet.
TEST(TurningCamera, WhatComesIntoViewSaturatedIsToldSo) {
  const auto frame_of = [](std::uint64_t i, const Exposure& exposure, double turned_rad,
                           bool lamp) {
    Image<Rgb> light(kSide, kSide, {5, 5, 5});
    for (int y = 100; y < 140 && lamp; ++y)
      for (int x = 190; x < 220; ++x) light.at(x, y) = {5000, 5000, 5000};
    Sensor sensor;
    sensor.response = camera().response;
    Frame frame;
    frame.sequence = i;
    frame.exposure = exposure;
    frame.world_from_camera.rotation = glm::angleAxis(turned_rad, dvec3(0, 1, 0));
    FramePixels pixels = Image<Rgb8>(kSide, kSide);
    expose(sensor, light, exposure, i, pixels);
    frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    return frame;
  };
  HdrRing ring(camera(), 8);
  for (std::uint64_t i = 0; i < 3; ++i) ASSERT_TRUE(ring.add(frame_of(i, kSchedule[i], 0, false)));
  const auto merged = ring.add(frame_of(3, kSchedule[0], -1.6, true));
  ASSERT_TRUE(merged);
  EXPECT_GT((*merged)->clipped_fraction, .015) << "1200 of 57600 pixels";
}

// Codes from a lens's bright middle are not those of its dim border.
TEST(TurningCamera, VignettedSkyStaysConstant) {
  CameraInfo dim = camera();
  dim.vignetting = {-.6, 0, 0};
  const Vignetting left = calib::vignetting_of(dim.projection, dim.vignetting);
  Image<Rgb> light(kSide, kSide);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x)
      light.at(x, y) = Rgb{30, 30, 30} * static_cast<float>(left.at({x + .5, y + .5}));
  HdrRing ring(dim, 8);
  Result<const MergedImage*> merged = nullptr;
  for (std::uint64_t i = 0; i < 4; ++i) {
    Sensor sensor;
    sensor.response = dim.response;
    Frame frame;
    frame.sequence = i;
    frame.exposure = kSchedule[i % 3];
    frame.world_from_camera.rotation = glm::angleAxis(i == 3 ? -.7 : 0., dvec3(0, 1, 0));
    FramePixels pixels = Image<Rgb8>(kSide, kSide);
    expose(sensor, light, frame.exposure, i, pixels);
    frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    merged = ring.add(frame);
  }
  ASSERT_TRUE(merged);
  double squares = 0, count = 0;
  for (int y = 40; y < kSide - 40; ++y)
    for (int x = 40; x < kSide - 40; ++x, ++count)
      squares += std::pow(double((*merged)->scale) *
                                  double(float_from_half((*merged)->pixels.at(x, y).g)) /
                                  double(light.at(x, y).g) -
                              1,
                          2);
  EXPECT_LT(std::sqrt(squares / count), .02);
}

TEST(TurningCamera, StandsStillAgain) {
  Sensor sensor;
  sensor.response = camera().response;
  sensor.noisy = false;
  HdrRing ring(camera(), 8), still(camera(), 8);
  Result<const MergedImage*> merged = nullptr, expected = nullptr;
  for (std::size_t i = 0; i < 9; ++i) {
    // Turned for two frames, then still: once each exposure is from here, nothing is left of the
    // turn.
    const glm::dquat pose = i < 2 ? glm::angleAxis(.1, dvec3(0, 1, 0)) : glm::dquat(1, 0, 0, 0);
    Frame frame;
    frame.sequence = i;
    frame.exposure = kSchedule[i % 3];
    frame.world_from_camera.rotation = pose;
    FramePixels pixels = Image<Rgb8>(kSide, kSide);
    expose(sensor, seen_from(pose), frame.exposure, i, pixels);
    frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    merged = ring.add(frame);
    if (i >= 2) expected = still.add(frame);
  }
  ASSERT_TRUE(merged && expected);
  EXPECT_TRUE((*merged)->pixels == (*expected)->pixels);
}

}  // namespace
}  // namespace penumbra::capture
