#include "runtime/pipeline/internal/pace.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace penumbra::runtime {
namespace {

// A machine on which a frame takes `base_ms` and each disc `disc_ms`, at 60 frames a second; it wants `wanted` discs.
struct Machine {
  double base_ms, disc_ms;
  int wanted = 1;
  int delay = 0;  // frames that the light needs to follow
  Pace pace{1e3 / 60};
  int discs = wanted;
  std::vector<int> allowed{};  // after each frame
  int late = 0;                // frames

  void run(int frames) {
    for (int i = 0; i < frames; ++i) {
      const double ms = base_ms + disc_ms * discs;
      late += ms > 1e3 / 60;
      pace.add(ms, discs);
      allowed.push_back(pace.most_discs());
      const auto told = static_cast<std::ptrdiff_t>(allowed.size()) - 1 - delay;
      if (told >= 0) discs = std::min(wanted, allowed[static_cast<std::size_t>(told)]);
    }
  }
};

TEST(Pace, WhatFitsStays) {
  Machine m{8, 8};
  m.run(6000);
  EXPECT_EQ(m.discs, 1);
  EXPECT_EQ(m.pace.most_discs(), Pace::kAll);
}

TEST(Pace, WhatDoesNotFitGoesWithinHalfASecond) {
  Machine m{10, 8};
  m.run(30);
  EXPECT_EQ(m.discs, 0);
}

TEST(Pace, WhatIsOnTrialGoesSooner) {
  Machine m{10, 8};
  m.run(8);
  EXPECT_EQ(m.discs, 0);
  m.base_ms = 4;
  while (m.discs == 0) m.run(1);
  m.base_ms = 10;  // as soon as it is back
  m.run(8);
  EXPECT_EQ(m.discs, 0);
}

TEST(Pace, DiscsGoOneByOneUntilTheRestFits) {
  Machine m{8, 3, 5};
  m.run(300);
  EXPECT_EQ(m.discs, 2);
}

TEST(Pace, ALightThatFollowsLateCostsItsDelayAlone) {
  for (const int delay : {0, 3, 10}) {
    Machine m{8, 3, 5, delay};
    m.run(300);
    EXPECT_EQ(m.discs, 2) << delay;
    EXPECT_LE(m.late, 3 * (8 + delay)) << delay;
  }
  // And one that comes back is tried when it is there.
  Machine m{10, 8, 1, 10};
  m.run(60);
  m.base_ms = 4;
  while (m.discs == 0) m.run(1);
  m.base_ms = 10;
  m.late = 0;
  m.run(60);
  EXPECT_LE(m.late, 8 + 10);
}

TEST(Pace, TriesAgainWhatDidNotFitLessAndLess) {
  Machine m{10, 8};
  int tries = 0, before = 1;
  for (int i = 0; i < 60 * 600; ++i) {
    m.run(1);
    tries += m.discs > before;
    before = m.discs;
  }
  EXPECT_LE(tries, 12) << "of ten minutes";
}

TEST(Pace, ADiscComesBackWhenTheMachineIsFree) {
  Machine m{10, 8};
  m.run(60);
  ASSERT_EQ(m.discs, 0);
  m.base_ms = 4;
  m.run(120);
  EXPECT_EQ(m.discs, 1);
}

TEST(Pace, OneSlowFrameIsNoReason) {
  Machine m{6, 6};
  m.run(50);
  m.pace.add(1000, 1);
  m.run(100);
  EXPECT_EQ(m.discs, 1);
}

TEST(Pace, ASlowSpellIsForgotten) {
  Machine m{6, 4};
  m.run(68);
  for (int i = 0; i < 25; ++i) m.pace.add(200, 1);
  m.run(1);
  EXPECT_EQ(m.discs, 0);
  m.run(60 * 60);
  EXPECT_EQ(m.discs, 1) << "a minute later";
}

TEST(Pace, WaitsForALightThatFollowsLate) {
  Pace pace{1e3 / 60};
  int discs = 2;
  for (int i = 0; i < 600; ++i) {
    pace.add(10 + 4 * discs, discs);
    ASSERT_GE(pace.most_discs(), 0);
    if (i % 120 == 119) discs = std::min(discs, pace.most_discs());
  }
  EXPECT_EQ(discs, 1) << "one at a time";
}

TEST(Pace, DiscsThatComeAndGoHideNothing) {
  Pace pace{1e3 / 60};
  for (int i = 0; i < 200; ++i) pace.add(30, 1 + i / 10 % 2);
  EXPECT_LT(pace.most_discs(), 2);
}

TEST(Pace, ALoadThatComesAndGoesIsFollowedLessAndLess) {
  // Every five seconds something else takes the time of the disc, or gives it back.
  Machine m{4, 8};
  int changes = 0, before = 1;
  for (int i = 0; i < 60 * 600; ++i) {
    m.base_ms = i / 300 % 2 == 0 ? 4 : 12;
    m.run(1);
    changes += m.discs != before;
    before = m.discs;
  }
  EXPECT_LE(changes, 20) << "of ten minutes";
  EXPECT_GE(changes, 2);
}

TEST(Pace, WithoutDiscsThereIsNothingToSpare) {
  Machine m{30, 8, 0};
  m.run(300);
  EXPECT_EQ(m.discs, 0);
  EXPECT_EQ(m.pace.most_discs(), Pace::kAll);
}

TEST(Pace, WithoutAPeriodEverythingIsAllowed) {
  Pace pace(0);
  for (int i = 0; i < 300; ++i) pace.add(1e6, 3);
  EXPECT_EQ(pace.most_discs(), Pace::kAll);
}

}  // namespace
}  // namespace penumbra::runtime
