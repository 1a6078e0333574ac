// Bands of lamps on the mains under a rolling shutter, and white balance that follows the picture.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <random>
#include <string>
#include <vector>

#include "capture/capture.h"
#include "capture/watch/mains_bands.h"
#include "core/conventions.h"
#include "core/io/log.h"
#include "tests/support/mains.h"

namespace penumbra::capture {
namespace {

constexpr int kBandWidth = 256, kBandHeight = 144;
using test::Mains;

const std::vector<double> kTimes_s = {.016, .004, .001};

Image<Rgb> room() {
  return test::room_on_mains(kBandWidth, kBandHeight);
}

Sensor band_sensor(int bits) {
  Sensor out;
  out.response = calib::Response::srgb();
  out.bits = bits;
  return out;
}

Frame film(const Sensor& sensor, const Image<Rgb>& scene, std::uint64_t n, const Mains& mains,
           Rgb colour = {1, 1, 1}) {
  return test::film_on_mains(sensor, scene, n, kTimes_s, mains, colour);
}

/// What light estimates are made of: all the light, that of the upper quarter, and of the lamps.
struct Light {
  double all = 0, upper = 0, lamps = 0;
};
template <class Radiance>
Light light_of(const Image<Rgb>& scene, const Radiance& radiance_at) {
  Light out;
  for (int y = 0; y < kBandHeight; ++y)
    for (int x = 0; x < kBandWidth; ++x) {
      const auto i = static_cast<std::size_t>(y * kBandWidth + x);
      const double light =
          latlong_solid_angle(y, kBandWidth, kBandHeight) * double(luminance(radiance_at(i)));
      out.all += light;
      if (y < kBandHeight / 4) out.upper += light;
      if (luminance(scene.pixels()[i]) > 100) out.lamps += light;
    }
  return out;
}

struct Flickers {
  double all, upper, lamps;
};
struct Series {
  std::vector<double> all, upper, lamps;
  void add(const Light& l) {
    all.push_back(l.all), upper.push_back(l.upper), lamps.push_back(l.lamps);
  }
  Flickers flickers() const {
    return {test::flicker_of(all), test::flicker_of(upper), test::flicker_of(lamps)};
  }
};

class Bits : public testing::TestWithParam<int> {};
TEST_P(Bits, BandsOfTheMainsAreTakenOut) {
  const Image<Rgb> scene = room();
  const Sensor sensor = band_sensor(GetParam());
  const bool few = GetParam() > 8;  // such frames are merged anew each time, which takes long
  const std::uint64_t frames = few ? 210 : 300;
  for (const double frequency_hz : {100., 120.})
    for (const double readout_s : {.012, .028}) {
      if (few && (frequency_hz > 100 || readout_s > .02)) continue;
      const Mains mains{frequency_hz, .2, readout_s};
      HdrRing ring(test::environment_camera(sensor, kBandWidth, kBandHeight));
      ExposureStack naive{std::vector<std::shared_ptr<const FramePixels>>(kTimes_s.size()),
                          {},
                          sensor.response,
                          sensor.noise,
                          0};
      naive.exposures = test::exposures_of(kTimes_s);
      Series ours, without;
      for (std::uint64_t n = 0; n < frames; ++n) {
        const Frame frame = film(sensor, scene, n, mains);
        naive.frames[n % kTimes_s.size()] = frame.pixels;
        const auto merged = ring.add(frame);
        ASSERT_TRUE(merged) << merged.error().detail;
        if (n + 60 < frames) continue;
        ours.add(light_of(scene, [&](std::size_t i) { return test::radiance_of(**merged, i); }));
        const auto all = merge(naive);
        without.add(light_of(scene, [&](std::size_t i) { return all->radiance.pixels()[i]; }));
      }
      const Flickers a = ours.flickers(), b = without.flickers();
      std::printf(
          "%3.0f Hz, read out in %2.0f ms: all %.2f %% (%.2f), upper quarter %.2f %% (%.2f), "
          "lamps %.2f %% (%.2f)\n",
          frequency_hz, 1000 * readout_s, 100 * a.all, 100 * b.all, 100 * a.upper, 100 * b.upper,
          100 * a.lamps, 100 * b.lamps);
      EXPECT_LT(a.all, .005);
      EXPECT_LT(a.upper, .005);
      EXPECT_LT(a.lamps, .005);
      EXPECT_GT(b.lamps, .02) << "without it";
    }
}
INSTANTIATE_TEST_SUITE_P(MainsBands, Bits, testing::Values(8, 12));

TEST(MainsBands, AStillSceneIsNotTouched) {
  const Image<Rgb> scene = room();
  const Sensor sensor = band_sensor(8);
  const CameraInfo camera = test::environment_camera(sensor, kBandWidth, kBandHeight);
  PictureHistory history(camera);
  MainsBands bands;
  for (std::uint64_t n = 0; n < 120; ++n) {
    const Frame frame = film(sensor, scene, n, {100, 0});
    EXPECT_FALSE(bands.find(history.compare(frame, frame.exposure))) << n;
    history.keep();
  }
}

// A lamp that is switched on below, a door that opens: no wave, although rows change.
TEST(MainsBands, AChangeOfTheSceneIsNoBand) {
  const Image<Rgb> scene = room();
  Image<Rgb> brighter = scene;
  for (int y = kBandHeight / 2; y < kBandHeight; ++y)
    for (int x = 0; x < kBandWidth; ++x) brighter.at(x, y) = brighter.at(x, y) * 1.6f;
  const Sensor sensor = band_sensor(8);
  HdrRing ring(test::environment_camera(sensor, kBandWidth, kBandHeight));
  const MergedImage* last = nullptr;
  for (std::uint64_t n = 0; n < 90; ++n) {
    const auto merged = ring.add(film(sensor, n < 60 ? scene : brighter, n, {100, 0}));
    ASSERT_TRUE(merged);
    last = *merged;
    if (n < 60 + kTimes_s.size()) continue;
    const Light truth = light_of(brighter, [&](std::size_t i) { return brighter.pixels()[i]; });
    const Light now =
        light_of(brighter, [&](std::size_t i) { return test::radiance_of(*last, i); });
    ASSERT_NEAR(now.all / truth.all, 1, .01) << n;
  }
}

// Light that changes while it flickers is believed within a second, be the change large or small.
TEST(MainsBands, ALampThatGoesOutIsFollowed) {
  for (const float left : {.5f, .8f}) {
    const Image<Rgb> scene = room();
    Image<Rgb> darker = scene;
    for (Rgb& p : darker.pixels()) p = p * left;
    const Sensor sensor = band_sensor(8);
    HdrRing ring(test::environment_camera(sensor, kBandWidth, kBandHeight));
    const Light truth = light_of(scene, [&](std::size_t i) { return darker.pixels()[i]; });
    for (std::uint64_t n = 0; n < 160; ++n) {
      const auto merged = ring.add(film(sensor, n < 90 ? scene : darker, n, {}));
      ASSERT_TRUE(merged);
      if (n < 90 + 30) continue;
      const Light now =
          light_of(scene, [&](std::size_t i) { return test::radiance_of(**merged, i); });
      ASSERT_NEAR(now.all / truth.all, 1, .03) << left << ' ' << n;
    }
  }
}

// Largest error of all the light while a lamp moves.
double error_of_a_moving_lamp(const Mains& mains) {
  const Sensor sensor = band_sensor(8);
  HdrRing ring(test::environment_camera(sensor, kBandWidth, kBandHeight));
  double worst = 0;
  for (std::uint64_t n = 0; n < 150; ++n) {
    Image<Rgb> scene = room();
    const int left = n < 90 ? 40 : static_cast<int>(40 + 8 * (n - 90)) % (kBandWidth - 12);
    for (int y = 60; y < 72; ++y)
      for (int x = left; x < left + 12; ++x) scene.at(x, y) = {230, 230, 230};
    const auto merged = ring.add(film(sensor, scene, n, mains));
    EXPECT_TRUE(merged);
    if (n < 93) continue;
    const Light truth = light_of(scene, [&](std::size_t i) { return scene.pixels()[i]; }),
                ours =
                    light_of(scene, [&](std::size_t i) { return test::radiance_of(**merged, i); });
    worst = std::max(worst, std::abs(ours.all / truth.all - 1));
  }
  return worst;
}

// A shorter exposure stands in for what is too bright only where it shows it, for it is older.
TEST(MainsBands, ALampThatMovesKeepsItsLight) {
  const double without = error_of_a_moving_lamp({100, 0}), with = error_of_a_moving_lamp({});
  std::printf("a lamp that moves: light off by at most %.1f %%, under the mains %.1f %%\n",
              100 * without, 100 * with);
  EXPECT_LT(with, without + .03);
}

// Fire, a television, a hand that shakes: rows change by waves at random, but not by the mains.
TEST(MainsBands, WhatFlickersOtherwiseIsNotTouched) {
  const Image<Rgb> scene = room();
  const Sensor sensor = band_sensor(8);
  const CameraInfo camera = test::environment_camera(sensor, kBandWidth, kBandHeight);
  std::mt19937 rng(3);
  std::uniform_real_distribution<float> random(-.1f, .1f);
  PictureHistory history(camera);
  MainsBands bands;
  int touched = 0;
  for (std::uint64_t n = 0; n < 300; ++n) {
    Image<Rgb> lit = scene;
    const float slope = random(rng);
    for (int y = 0; y < kBandHeight; ++y)
      for (int x = 0; x < kBandWidth; ++x)
        lit.at(x, y) = lit.at(x, y) * (1 + slope * (2.f * static_cast<float>(y) / kBandHeight - 1));
    const Frame frame = film(sensor, lit, n, {100, 0});
    touched += bands.find(history.compare(frame, frame.exposure)).has_value();
    history.keep();
  }
  EXPECT_LE(touched, 3);
}

std::vector<std::string> warnings_of(const std::function<Rgb(std::uint64_t)>& colour,
                                     std::uint64_t frames = 120) {
  std::vector<std::string> out;
  set_log_sink([&](LogLevel level, std::string_view text) {
    if (level == LogLevel::kWarning) out.emplace_back(text);
  });
  const Image<Rgb> scene = room();
  const Sensor sensor = band_sensor(8);
  HdrRing ring(test::environment_camera(sensor, kBandWidth, kBandHeight));
  for (std::uint64_t n = 0; n < frames; ++n)
    EXPECT_TRUE(ring.add(film(sensor, scene, n, {100, 0}, colour ? colour(n) : Rgb{1, 1, 1})));
  set_log_sink({});
  return out;
}

TEST(WhiteBalance, ThatFollowsThePictureIsWarnedOfOnce) {
  const auto all = warnings_of([](std::uint64_t n) {
    const auto drift = static_cast<float>(n < 40 ? 0 : std::min(1., double(n - 40) / 30));
    return Rgb{1 + .12f * drift, 1, 1 - .1f * drift};
  });
  ASSERT_EQ(all.size(), 1u);
  EXPECT_NE(all[0].find("white balance"), std::string::npos) << all[0];
}

TEST(WhiteBalance, LightThatChangesIsNoWhiteBalance) {
  for (const Rgb& other : {Rgb{1.5f, 1.4f, 1.3f}, Rgb{1.1f, 1.06f, 1.02f}, Rgb{.9f, .9f, .9f}}) {
    const auto told = warnings_of([&](std::uint64_t n) { return n < 40 ? Rgb{1, 1, 1} : other; });
    EXPECT_TRUE(told.empty()) << told[0];
  }
  EXPECT_TRUE(warnings_of({}).empty());
}

}  // namespace
}  // namespace penumbra::capture
