#include "shadows/shadows.h"
#include "prt/prt.h"
#include "lighting/lighting.h"
#include "shadows/silhouette/disc_rays.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>

#include "core/conventions.h"

namespace penumbra::shadows {
namespace {

// A strip of the sky: 64 directions, `across` and `along` radians from end to end.
lighting::Disc strip(double across, double along) {
  lighting::Disc d;
  d.direction = {0, 1, 0};
  d.radius = Radians(std::sqrt(across * along / kPi));
  for (int i = 0; i < 64; ++i) {
    const double x = across * ((i / 16 + .5) / 4 - .5), z = along * ((i % 16 + .5) / 16 - .5);
    d.shape.push_back(glm::normalize(glm::dvec3(x, 1, z)));
  }
  return d;
}

TEST(DiscRays, ADiscReachesAsFarAsItsFarthestDirection) {
  lighting::Disc d;
  d.direction = glm::normalize(glm::dvec3(1, 2, 3));
  d.radius = Radians(.1);
  EXPECT_DOUBLE_EQ(largest_angle(d), .1);
  EXPECT_NEAR(largest_angle(strip(.04, .8)), .36, .01);
}

TEST(DiscRays, OneTapOfAllIsTheMiddle) {
  lighting::Disc d;
  d.direction = glm::normalize(glm::dvec3(1, 2, 3));
  d.radius = Radians(.04);
  TapPattern pattern;
  pattern.make(d, 1, 1);
  EXPECT_LT(glm::distance(glm::dvec3(pattern.at(0)[0]), d.direction), 1e-6);
  pattern.make(d, 1, 64);  // by turns it covers the disc
  EXPECT_GT(glm::distance(glm::dvec3(pattern.at(5)[0]), d.direction), .02);
}

TEST(DiscRays, TapsShareAFormsDirectionsOut) {
  const lighting::Disc d = strip(.1, .4);
  for (const int taps : {1, 4, 16, 32, 64}) {
    TapPattern pattern;
    pattern.make(d, taps, 1);
    glm::dvec3 mean(0), wanted(0);
    for (const glm::vec3& t : pattern.at(0)) mean += glm::dvec3(t) / double(taps);
    for (const glm::dvec3& s : d.shape) wanted += s / 64.;
    EXPECT_LT(glm::length(glm::normalize(mean) - glm::normalize(wanted)), 2e-3) << taps;
  }
}

TEST(DiscRays, TurnsTakeEveryDirectionAlike) {
  const lighting::Disc d = strip(.1, .4);
  TapPattern pattern;
  pattern.make(d, 4, 64);
  std::map<std::pair<float, float>, int> seen;
  for (std::size_t turn = 0; turn < 64; ++turn)
    for (const glm::vec3& t : pattern.at(turn)) ++seen[{t.x, t.z}];
  EXPECT_EQ(seen.size(), 64u);
  for (const auto& [direction, times] : seen) EXPECT_NEAR(times, 4, 1);
}

// Wherever one begins: what a few points that follow each other ask lies all over the form, each quarter along it alike.
TEST(DiscRays, TurnsInARowAskAllOfAForm) {
  const lighting::Disc d = strip(.4, .1);
  TapPattern pattern;
  pattern.make(d, 4, 64);
  for (std::size_t first = 0; first + 4 <= 64; ++first) {
    std::array<int, 4> in{};
    for (std::size_t turn = first; turn < first + 4; ++turn)
      for (const glm::vec3& t : pattern.at(turn))
        ++in[static_cast<std::size_t>(4 * (t.x / t.y / .4f + .5f))];
    for (const int n : in) EXPECT_NEAR(n, 4, 1) << first;
  }
}

TEST(DiscRays, WhatIsNarrowIsSoInEveryDirection) {
  lighting::Disc round;
  round.direction = {0, 1, 0};
  round.radius = Radians(.02);
  EXPECT_FALSE(is_broad(round));
  EXPECT_FALSE(is_broad(strip(.02, .05)));
  EXPECT_TRUE(is_broad(strip(.002, .4)));  // as long as it is thin
  round.radius = Radians(.06);
  EXPECT_TRUE(is_broad(round));
}

TEST(DiscRays, RmsAngleIsTheCapsOrTheForms) {
  lighting::Disc round;
  round.direction = {0, 1, 0};
  round.radius = Radians(.1);
  EXPECT_NEAR(rms_angle(round), .1 / std::sqrt(2.), 1e-9);
  const lighting::Disc thin = strip(.002, .4);
  EXPECT_GT(rms_angle(thin), .15 / std::sqrt(3.));
  EXPECT_LT(rms_angle(thin), largest_angle(thin));
}

// The same lamp is smooth on a fine mesh and not on a coarse one; on one mesh a wide lamp is and a narrow one is not.
TEST(DiscRays, NeighboursShareLightWhereEdgesAreShort) {
  const prt::Mesh fine = prt::make_knot(.5f, 320, 52, {}), coarse = prt::make_knot(.5f, 80, 16, {});
  lighting::Disc lamp;
  lamp.direction = {0, 1, 0};
  lamp.radius = Radians(.08);
  EXPECT_TRUE(is_smooth(lamp, Outline(fine)));
  EXPECT_FALSE(is_smooth(lamp, Outline(coarse)));
  EXPECT_TRUE(is_smooth(lamp, Outline())) << "nothing to blur";
  lamp.radius = Radians(.02);
  EXPECT_FALSE(is_smooth(lamp, Outline(fine)));
}

}  // namespace
}  // namespace penumbra::shadows
