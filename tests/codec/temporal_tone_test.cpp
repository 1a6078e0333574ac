#include "codec/tone/temporal_tone.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "codec/tone/tone_mapping.h"
#include "core/units.h"

namespace penumbra::tone {
namespace {

// Fields of light over five decades, all `factor` times as bright.
Image<Rgb> filmed(float factor = 1) {
  Image<Rgb> out(120, 80);
  for (int y = 0; y < 80; ++y)
    for (int x = 0; x < 120; ++x) {
      const float l = factor * std::exp(2.3f * static_cast<float>((x / 24 + 2 * (y / 20)) % 5) +
                                        .3f * std::sin(.4f * static_cast<float>(x + y)));
      out.at(x, y) = {l, .8f * l, .6f * l};
    }
  return out;
}

TEST(TemporalTone, TheFirstPictureIsTakenAsItIs) {
  TemporalTone tone({});
  const auto first = tone.map(filmed(), {}), alone = tone_map(filmed());
  ASSERT_TRUE(first && alone);
  EXPECT_EQ(first->pixels, alone->pixels);
}

// A step of the light by a factor e^2 in every statistic: after one constant 63 % of it.
TEST(TemporalTone, FollowsAStepWithItsTimeConstant) {
  TemporalTone tone({}, Seconds(.5));
  ASSERT_TRUE(tone.map(filmed(), {}));
  const double before = tone.adaptation()->median;
  const float brighter = std::exp(2.f);
  for (int k = 1; k <= 10; ++k)
    ASSERT_TRUE(tone.map(filmed(brighter), TimestampNs{} + Seconds(.05 * k)));
  EXPECT_NEAR(tone.adaptation()->median - before, 2 * (1 - std::exp(-1.)), .01);
  ASSERT_TRUE(tone.map(filmed(brighter), TimestampNs{} + Seconds(3)));
  EXPECT_NEAR(tone.adaptation()->median - before, 2, .02);
}

// Light that flickers at 10 Hz by a fifth, at 60 frames a second.
TEST(TemporalTone, TakesFlickerOutOfTheAdaptation) {
  TemporalTone tone({}, Seconds(.4));
  double low = HUGE_VAL, high = -HUGE_VAL;
  for (int k = 0; k < 240; ++k) {
    const double t = k / 60., swing = .2 * std::sin(2 * std::numbers::pi * 10 * t);
    ASSERT_TRUE(tone.map(filmed(static_cast<float>(std::exp(swing))), TimestampNs{} + Seconds(t)));
    if (k < 180) continue;
    low = std::min(low, tone.adaptation()->mean), high = std::max(high, tone.adaptation()->mean);
  }
  const double through = 1 / std::sqrt(1 + std::pow(2 * std::numbers::pi * 10 * .4, 2));
  EXPECT_LT((high - low) / .4, 1.2 * through);
  EXPECT_GT((high - low) / .4, .5 * through);
}

TEST(TemporalTone, DoesNotDependOnTheFrameRate) {
  TemporalTone slow({}, Seconds(.3)), fast({}, Seconds(.3));
  ASSERT_TRUE(slow.map(filmed(), {}) && fast.map(filmed(), {}));
  for (int k = 1; k <= 10; ++k) ASSERT_TRUE(slow.map(filmed(5), TimestampNs{} + Seconds(.04 * k)));
  for (int k = 1; k <= 40; ++k) ASSERT_TRUE(fast.map(filmed(5), TimestampNs{} + Seconds(.01 * k)));
  EXPECT_NEAR(slow.adaptation()->mean, fast.adaptation()->mean, 1e-6);
}

TEST(TemporalTone, BlackAndBadPicturesLeaveTheAdaptation) {
  TemporalTone tone({});
  ASSERT_TRUE(tone.map(filmed(), {}));
  const double before = tone.adaptation()->median;
  ASSERT_TRUE(tone.map(Image<Rgb>(120, 80), TimestampNs{} + Seconds(1)));
  EXPECT_EQ(tone.adaptation()->median, before);
  Image<Rgb> bad = filmed(9);
  bad.at(1, 1).r = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(tone.map(bad, TimestampNs{} + Seconds(2)));
  EXPECT_EQ(tone.adaptation()->median, before);
  const auto back = tone.map(filmed(), TimestampNs{} + Seconds(.5));
  ASSERT_FALSE(back);
  EXPECT_EQ(back.error().code, ErrorCode::kInvalid);
  EXPECT_FALSE(TemporalTone({}, Seconds(-1)).map(filmed(), {}));
}

TEST(TemporalTone, AfterALongGapAPictureIsTakenAsItIs) {
  TemporalTone tone({}, Seconds(.1));
  ASSERT_TRUE(tone.map(filmed(), {}));
  const auto mapped = tone.map(filmed(100), TimestampNs{} + Seconds(60));
  const auto alone = tone_map(filmed(100));
  ASSERT_TRUE(mapped && alone);
  EXPECT_EQ(mapped->pixels, alone->pixels);
}

}  // namespace
}  // namespace penumbra::tone
