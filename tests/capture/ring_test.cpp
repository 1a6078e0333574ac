#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/half.h"
#include "tests/support/brackets.h"

namespace penumbra::capture {
namespace {

constexpr int kRingWidth = 40, kRingHeight = 20;
constexpr double kTimes[] = {1, 1. / 4, 1. / 16, 1. / 64};

CameraInfo camera(const Sensor& sensor) {
  return test::environment_camera(sensor, kRingWidth, kRingHeight);
}

Sensor sensor_of(int bits) {
  Sensor s;
  s.response = calib::Response::srgb();
  s.bits = bits;
  s.noisy = false;
  return s;
}

Frame frame(const Sensor& sensor, float radiance, double time, std::uint64_t sequence) {
  Frame f;
  f.sequence = sequence;
  f.exposure = {Seconds(time), Gain(1)};
  f.pixels = test::shot(sensor, Image<Rgb>(kRingWidth, kRingHeight, {radiance, radiance, radiance}),
                        f.exposure, sequence);
  return f;
}

/// Largest relative distance of a pixel from `expected`; NaN counts as infinitely far.
double farthest(const MergedImage& image, double expected) {
  double worst = 0;
  for (const HalfRgba& p : image.pixels.pixels())
    for (const std::uint16_t bits : {p.r, p.g, p.b}) {
      const double d = std::abs(double(image.scale) * double(float_from_half(bits)) / expected - 1);
      if (!(d <= worst)) worst = std::isnan(d) ? std::numeric_limits<double>::infinity() : d;
    }
  return worst;
}

// Half a bracket's light is too dim, and what is read off the floor for a light that a shorter
// exposure would have resolved is wrong.
TEST(HdrRing, KnowsTheBracketOnceAnExposureComesBack) {
  const auto frames_until_complete = [](std::initializer_list<int> halvings, int slots) {
    const Sensor sensor = sensor_of(8);
    HdrRing ring(camera(sensor), slots);
    std::uint64_t i = 0;
    for (const int h : halvings) {
      if (ring.bracket_complete()) return i;
      (void)ring.add(frame(sensor, .4f, std::ldexp(1., -h), i++));
    }
    return ring.bracket_complete() ? i : 0;
  };
  EXPECT_EQ(frames_until_complete({0, 2, 0, 2}, 8), 3u);
  EXPECT_EQ(frames_until_complete({0, 1, 2, 3, 4, 5, 6, 7, 0, 1}, 16), 9u) << "longest first";
  EXPECT_EQ(frames_until_complete({0, 0, 1, 2, 3, 0}, 8), 6u) << "a frame twice is no bracket";
  EXPECT_EQ(frames_until_complete({0, 0, 0, 0}, 8), 3u) << "one exposure alone";
  EXPECT_EQ(frames_until_complete({0, 1, 2, 3, 4}, 4), 4u) << "the ring is full";
}

// Three exposures in turn, of which each frame says what `label` makes of its number.
template <class Label>
double worst_of_labelled(std::uint64_t frames, std::uint64_t from, const Label& label) {
  const std::array<double, 3> times_s = {1, .25, .0625};
  const Sensor sensor = sensor_of(8);
  HdrRing ring(camera(sensor), 8);
  double worst = 0;
  std::uint64_t images = 0;
  for (std::uint64_t i = 0; i < frames; ++i) {
    Frame f = frame(sensor, .4f, times_s[i % 3], i);
    f.time = TimestampNs{static_cast<std::int64_t>(i) * 33'000'000};
    f.exposure.time = Seconds(times_s[label(i) % 3]);
    const auto image = ring.add(f);
    if (!image && image.error().code != ErrorCode::kUndetermined) return HUGE_VAL;
    if (i < from || !image) continue;
    worst = std::max(worst, farthest(**image, .4));
    ++images;
  }
  return images > (frames - from) * 8 / 10 ? worst : HUGE_VAL;
}

// A wrong label would light the scene by four times, or a quarter, until its exposure comes again.
TEST(HdrRing, AFrameThatContradictsItsLabelIsLeftOut) {
  const double right = worst_of_labelled(60, 6, [](std::uint64_t i) { return i; });
  const auto slips = [](std::uint64_t i) { return i % 20 == 19 ? i - 1 : i; };
  const double slipped = worst_of_labelled(60, 6, slips);
  std::printf("label slips: %.3f %% off, %.3f %% without\n", 100 * slipped, 100 * right);
  EXPECT_LT(slipped, right + .005);
}

TEST(HdrRing, LabelsThatAreLateThroughoutAreReadAsTheyAreMeant) {
  const double late = worst_of_labelled(90, 45, [](std::uint64_t i) { return i + 2; });
  EXPECT_LT(late, .02);
}

// Light that changes as a whole looks like late labels for a while, but is none: labels that are
// right stay so, also once a frame is lost.
TEST(HdrRing, RightLabelsOutliveLightThatFades) {
  const std::array<double, 3> times_s = {1, .25, .0625};
  const Sensor sensor = sensor_of(8);
  HdrRing ring(camera(sensor), 8);
  float radiance = .1f;
  for (std::uint64_t i = 0, n = 0; i < 80; ++i, ++n) {
    if (i > 20 && i < 26) radiance *= 1.35f;
    if (i == 50) ++n;  // a frame is lost
    Frame f = frame(sensor, radiance, times_s[n % 3], i);
    f.time = TimestampNs{static_cast<std::int64_t>(n) * 33'000'000};
    const auto image = ring.add(f);
    if (i < 45) continue;
    ASSERT_TRUE(image) << i << ": " << image.error().detail;
    EXPECT_LT(farthest(**image, double(radiance)), .02) << i;
  }
}

TEST(HdrRing, FirstFrameAloneIsAnImage) {
  for (const int bits : {8, 16}) {
    HdrRing ring(camera(sensor_of(bits)), 4);
    const auto image = ring.add(frame(sensor_of(bits), .4f, 1, 0));
    ASSERT_TRUE(image) << image.error().detail;
    EXPECT_EQ((*image)->pixels.width(), kRingWidth);
    EXPECT_EQ((*image)->pixels.height(), kRingHeight);
    EXPECT_LT(farthest(**image, .4), .02) << bits;
  }
}

TEST(HdrRing, PublishesAfterEveryFrame) {
  for (const int bits : {8, 16}) {
    HdrRing ring(camera(sensor_of(bits)), 4);
    for (std::uint64_t i = 0; i < 12; ++i) {
      const auto image = ring.add(frame(sensor_of(bits), .7f, kTimes[i % 4], i));
      ASSERT_TRUE(image) << i;
      EXPECT_LT(farthest(**image, .7), .02) << bits << " bit, frame " << i;
      EXPECT_EQ((*image)->clipped_fraction, 0);
    }
  }
}

TEST(HdrRing, LampSwitchedOffOrOnLeavesNoGhostAfterOneRound) {
  for (const int bits : {8, 16})
    for (const auto& [before, after] : {std::pair{30.f, .6f}, {.6f, 30.f}, {5.f, 4.f}}) {
      HdrRing ring(camera(sensor_of(bits)),
                   8);  // more slots than exposures: forgetting goes by exposure
      std::uint64_t sequence = 0;
      for (; sequence < 9; ++sequence)
        ASSERT_TRUE(ring.add(frame(sensor_of(bits), before, kTimes[sequence % 4], sequence)) ||
                    sequence < 4);
      Result<const MergedImage*> last = nullptr;
      for (int k = 0; k < 4; ++k, ++sequence)
        last = ring.add(frame(sensor_of(bits), after, kTimes[sequence % 4], sequence));
      ASSERT_TRUE(last);
      EXPECT_LT(farthest(**last, after), .02) << bits << " bit, " << before << " to " << after;
    }
}

TEST(HdrRing, OldestFrameLeavesWhenTheSlotsAreFull) {
  const Sensor sensor = sensor_of(16);
  HdrRing ring(camera(sensor), 2);
  ASSERT_TRUE(ring.add(frame(sensor, .9f, 1, 0)));
  ASSERT_TRUE(ring.add(frame(sensor, .3f, 1. / 4, 1)));
  const auto image = ring.add(frame(sensor, .3f, 1. / 16, 2));
  ASSERT_TRUE(image);
  EXPECT_LT(farthest(**image, .3), .02);
}

// With fewer slots than exposures the picture would pulse: a bright one leaves as the dark one
// comes.
TEST(HdrRing, ElevenExposuresAreAllMergedAndMoreThanFitAreRefusedByName) {
  const Sensor sensor = sensor_of(8);
  const auto round = [&](HdrRing& ring, int exposures, std::uint64_t from) {
    Result<const MergedImage*> last = nullptr;
    for (int i = 0; i < exposures && last; ++i)
      last = ring.add(frame(sensor, .2f, std::pow(.7, i), from + static_cast<std::uint64_t>(i)));
    return last;
  };
  HdrRing ring(camera(sensor));
  for (std::uint64_t k = 0; k < 3; ++k) {
    const auto image = round(ring, 11, 11 * k);
    ASSERT_TRUE(image) << image.error().detail;
    EXPECT_LT(farthest(**image, .2), .02) << k;
  }
  EXPECT_EQ(ring.exposures(), 11U);
  HdrRing few(camera(sensor), 8);
  ASSERT_TRUE(round(few, 8, 0));
  const auto refused = [&] {
    Result<const MergedImage*> last = nullptr;
    for (std::uint64_t k = 0; k < 5 && last; ++k) last = round(few, 11, 100 + 11 * k);
    return last;
  }();
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInvalid);
  EXPECT_EQ(refused.error().where, camera(sensor).name);
  EXPECT_NE(refused.error().detail.find("8 exposures"), std::string::npos);
}

// A camera that finds its exposure takes a new one with every frame: none comes again.
TEST(HdrRing, ARampOfExposuresIsNoBracket) {
  const Sensor sensor = sensor_of(8);
  HdrRing ring(camera(sensor), 4);
  for (std::uint64_t i = 0; i < 60; ++i)
    ASSERT_TRUE(ring.add(frame(sensor, .4f, std::pow(.96, double(i)), i))) << i;
}

// One that seeks goes up and down through the same exposures.
TEST(HdrRing, ASeekingCameraIsNoBracket) {
  const Sensor sensor = sensor_of(8);
  for (const std::uint64_t steps : {5, 9, 12, 30}) {
    HdrRing ring(camera(sensor), 4);
    for (std::uint64_t i = 0; i < 6 * steps; ++i) {
      const std::uint64_t k = i % (2 * steps), step = k < steps ? k : 2 * steps - k;
      ASSERT_TRUE(ring.add(frame(sensor, .4f, std::pow(.96, double(step)), i)))
          << steps << " steps, frame " << i;
    }
  }
}

TEST(HdrRing, FrameOfTheWrongSizeIsRefusedByNameAndChangesNothing) {
  const Sensor sensor = sensor_of(8);
  HdrRing ring(camera(sensor), 4);
  ASSERT_TRUE(ring.add(frame(sensor, .5f, 1, 0)));
  Frame wrong = frame(sensor, .5f, 1. / 4, 17);
  wrong.pixels = std::make_shared<const FramePixels>(Image<Rgb8>(kRingHeight, kRingWidth));
  const auto image = ring.add(wrong);
  ASSERT_FALSE(image);
  EXPECT_EQ(image.error().code, ErrorCode::kInvalid);
  EXPECT_NE(image.error().where.find("fisheye"), std::string::npos) << image.error().where;
  EXPECT_NE(image.error().where.find("17"), std::string::npos) << image.error().where;
  const auto next = ring.add(frame(sensor, .5f, 1. / 4, 18));
  ASSERT_TRUE(next);
  EXPECT_LT(farthest(**next, .5), .02);
}

TEST(HdrRing, BadExposureIsRefused) {
  const Sensor sensor = sensor_of(8);
  HdrRing ring(camera(sensor), 4);
  for (const double bad : {0., -1., std::numeric_limits<double>::quiet_NaN(),
                           std::numeric_limits<double>::infinity()}) {
    Frame f = frame(sensor, .5f, 1, 0);
    f.exposure.time = Seconds(bad);
    const auto image = ring.add(f);
    ASSERT_FALSE(image);
    EXPECT_EQ(image.error().code, ErrorCode::kInvalid);
  }
}

TEST(HdrRing, AllBlackAndAllClippedAreStatesThatPass) {
  for (const int bits : {8, 16}) {
    const Sensor sensor = sensor_of(bits);
    HdrRing ring(camera(sensor), 4);
    for (const float useless : {0.f, 1e4f}) {
      const auto image = ring.add(frame(sensor, useless, 1, 0));
      ASSERT_FALSE(image) << bits << ' ' << useless;
      EXPECT_EQ(image.error().code, ErrorCode::kUndetermined);
    }
    EXPECT_TRUE(ring.add(frame(sensor, .5f, 1, 1))) << "the ring goes on";
  }
}

}  // namespace
}  // namespace penumbra::capture
