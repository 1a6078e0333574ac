#include "runtime/pipeline/internal/frame_budget.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace penumbra::runtime {
namespace {

// A machine on which a frame takes `base_ms` and each light `light_ms`, at 60 frames a second; it
// wants `wanted` lights.
struct Machine {
  double base_ms, light_ms;
  int wanted = 1;
  int delay = 0;  // frames that the light needs to follow
  FrameBudget pace{1e3 / 60};
  int lights = wanted;
  std::vector<int> allowed{};  // after each frame
  int late = 0;                // frames

  void run(int frames) {
    for (int i = 0; i < frames; ++i) {
      const double ms = base_ms + light_ms * lights;
      late += ms > 1e3 / 60;
      pace.add(ms, lights);
      allowed.push_back(pace.max_lights());
      const auto told = static_cast<std::ptrdiff_t>(allowed.size()) - 1 - delay;
      if (told >= 0) lights = std::min(wanted, allowed[static_cast<std::size_t>(told)]);
    }
  }
};

TEST(FrameBudget, WhatFitsStays) {
  Machine m{8, 8};
  m.run(6000);
  EXPECT_EQ(m.lights, 1);
  EXPECT_EQ(m.pace.max_lights(), FrameBudget::kAll);
}

TEST(FrameBudget, WhatDoesNotFitGoesWithinHalfASecond) {
  Machine m{10, 8};
  m.run(30);
  EXPECT_EQ(m.lights, 0);
}

// While objects are baked a light seems to cost what the bakes take: it would stay away for long.
TEST(FrameBudget, AnotherSceneStartsOver) {
  const auto frames_without = [](bool starts_over) {
    Machine m{60, 8, 2};
    m.run(4000);
    EXPECT_EQ(m.lights, 0);
    m.base_ms = 4, m.light_ms = 2;
    if (starts_over) m.pace.start_over();
    int frames = 0;
    for (; m.lights < 2 && frames < 4000; ++frames) m.run(1);
    return frames;
  };
  EXPECT_GT(frames_without(false), 200);
  EXPECT_LE(frames_without(true), 2);
}

TEST(FrameBudget, WhatIsOnTrialGoesSooner) {
  Machine m{10, 8};
  m.run(8);
  EXPECT_EQ(m.lights, 0);
  m.base_ms = 4;
  while (m.lights == 0) m.run(1);
  m.base_ms = 10;  // as soon as it is back
  m.run(8);
  EXPECT_EQ(m.lights, 0);
}

TEST(FrameBudget, LightsGoOneByOneUntilTheRestFits) {
  Machine m{8, 3, 5};
  m.run(300);
  EXPECT_EQ(m.lights, 2);
}

TEST(FrameBudget, ALightThatFollowsLateCostsItsDelayAlone) {
  for (const int delay : {0, 3, 10}) {
    Machine m{8, 3, 5, delay};
    m.run(300);
    EXPECT_EQ(m.lights, 2) << delay;
    EXPECT_LE(m.late, 3 * (8 + delay)) << delay;
  }
  // And one that comes back is tried when it is there.
  Machine m{10, 8, 1, 10};
  m.run(60);
  m.base_ms = 4;
  while (m.lights == 0) m.run(1);
  m.base_ms = 10;
  m.late = 0;
  m.run(60);
  EXPECT_LE(m.late, 8 + 10);
}

TEST(FrameBudget, TriesAgainWhatDidNotFitLessAndLess) {
  Machine m{10, 8};
  int tries = 0, before = 1;
  for (int i = 0; i < 60 * 600; ++i) {
    m.run(1);
    tries += m.lights > before;
    before = m.lights;
  }
  EXPECT_LE(tries, 12) << "of ten minutes";
}

TEST(FrameBudget, ALightComesBackWhenTheMachineIsFree) {
  Machine m{10, 8};
  m.run(60);
  ASSERT_EQ(m.lights, 0);
  m.base_ms = 4;
  m.run(120);
  EXPECT_EQ(m.lights, 1);
}

TEST(FrameBudget, OneSlowFrameIsNoReason) {
  Machine m{6, 6};
  m.run(50);
  m.pace.add(1000, 1);
  m.run(100);
  EXPECT_EQ(m.lights, 1);
}

TEST(FrameBudget, ASlowSpellIsForgotten) {
  Machine m{6, 4};
  m.run(68);
  for (int i = 0; i < 25; ++i) m.pace.add(200, 1);
  m.run(1);
  EXPECT_EQ(m.lights, 0);
  m.run(60 * 60);
  EXPECT_EQ(m.lights, 1) << "a minute later";
}

TEST(FrameBudget, WaitsForALightThatFollowsLate) {
  FrameBudget pace{1e3 / 60};
  int lights = 2;
  for (int i = 0; i < 600; ++i) {
    pace.add(10 + 4 * lights, lights);
    ASSERT_GE(pace.max_lights(), 0);
    if (i % 120 == 119) lights = std::min(lights, pace.max_lights());
  }
  EXPECT_EQ(lights, 1) << "one at a time";
}

TEST(FrameBudget, LightsThatComeAndGoHideNothing) {
  FrameBudget pace{1e3 / 60};
  for (int i = 0; i < 200; ++i) pace.add(30, 1 + i / 10 % 2);
  EXPECT_LT(pace.max_lights(), 2);
}

TEST(FrameBudget, ALoadThatComesAndGoesIsFollowedLessAndLess) {
  // Every five seconds something else takes the time of the light, or gives it back.
  Machine m{4, 8};
  int changes = 0, before = 1;
  for (int i = 0; i < 60 * 600; ++i) {
    m.base_ms = i / 300 % 2 == 0 ? 4 : 12;
    m.run(1);
    changes += m.lights != before;
    before = m.lights;
  }
  EXPECT_LE(changes, 20) << "of ten minutes";
  EXPECT_GE(changes, 2);
}

// One of the two that went has left the scene, and nothing is waited for: it would be given back
// for ever.
TEST(FrameBudget, WhatNobodyUsesIsNotGivenBackAgainAndAgain) {
  Machine m{8, 4, 4};
  m.run(300);
  ASSERT_EQ(m.lights, 2);
  m.wanted = 1, m.base_ms = 4;
  m.run(60 * 60);
  EXPECT_EQ(m.pace.max_lights(), FrameBudget::kAll);
  int changes = 0;
  for (std::size_t i = 301; i < m.allowed.size(); ++i) changes += m.allowed[i] != m.allowed[i - 1];
  EXPECT_LE(changes, 2);
  m.wanted = 4, m.base_ms = 8;
  m.run(300);
  EXPECT_EQ(m.lights, 2) << "and what comes back is tried";
}

TEST(FrameBudget, WithoutLightsThereIsNothingToSpare) {
  Machine m{30, 8, 0};
  m.run(300);
  EXPECT_EQ(m.lights, 0);
  EXPECT_EQ(m.pace.max_lights(), FrameBudget::kAll);
}

TEST(FrameBudget, WithoutAPeriodEverythingIsAllowed) {
  FrameBudget pace(0);
  for (int i = 0; i < 300; ++i) pace.add(1e6, 3);
  EXPECT_EQ(pace.max_lights(), FrameBudget::kAll);
}

}  // namespace
}  // namespace penumbra::runtime
