#include "shadows/silhouette/light_rays.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>

#include "core/conventions.h"

namespace penumbra::shadows {
namespace {

// A strip of the sky: 64 directions, `across` and `along` radians from end to end.
lighting::DistantLight strip(double across, double along) {
  lighting::DistantLight d;
  d.direction = {0, 1, 0};
  d.radius = Radians(std::sqrt(across * along / kPi));
  for (int i = 0; i < 64; ++i) {
    const double x = across * ((i / 16 + .5) / 4 - .5), z = along * ((i % 16 + .5) / 16 - .5);
    d.shape.push_back(glm::normalize(glm::dvec3(x, 1, z)));
  }
  return d;
}

TEST(LightRays, ALightReachesAsFarAsItsFarthestDirection) {
  lighting::DistantLight d;
  d.direction = glm::normalize(glm::dvec3(1, 2, 3));
  d.radius = Radians(.1);
  EXPECT_DOUBLE_EQ(largest_angle(d), .1);
  EXPECT_NEAR(largest_angle(strip(.04, .8)), .36, .01);
}

TEST(LightRays, OneSampleOfAllIsTheMiddle) {
  lighting::DistantLight d;
  d.direction = glm::normalize(glm::dvec3(1, 2, 3));
  d.radius = Radians(.04);
  SamplePattern pattern;
  pattern.make(d, 1, 1);
  EXPECT_LT(glm::distance(glm::dvec3(pattern.at(0)[0]), d.direction), 1e-6);
  pattern.make(d, 1, 64);  // by turns it covers the light
  EXPECT_GT(glm::distance(glm::dvec3(pattern.at(5)[0]), d.direction), .02);
}

TEST(LightRays, SamplesShareAFormsDirectionsOut) {
  const lighting::DistantLight d = strip(.1, .4);
  for (const int samples : {1, 4, 16, 32, 64}) {
    SamplePattern pattern;
    pattern.make(d, samples, 1);
    glm::dvec3 mean(0), wanted(0);
    for (const glm::vec3& t : pattern.at(0)) mean += glm::dvec3(t) / double(samples);
    for (const glm::dvec3& s : d.shape) wanted += s / 64.;
    EXPECT_LT(glm::length(glm::normalize(mean) - glm::normalize(wanted)), 2e-3) << samples;
  }
}

TEST(LightRays, TurnsTakeEveryDirectionAlike) {
  const lighting::DistantLight d = strip(.1, .4);
  SamplePattern pattern;
  pattern.make(d, 4, 64);
  std::map<std::pair<float, float>, int> seen;
  for (std::size_t turn = 0; turn < 64; ++turn)
    for (const glm::vec3& t : pattern.at(turn)) ++seen[{t.x, t.z}];
  EXPECT_EQ(seen.size(), 64u);
  for (const auto& [direction, times] : seen) EXPECT_NEAR(times, 4, 1);
}

// Wherever one begins: what a few points that follow each other ask lies all over the form, each
// quarter along it alike.
TEST(LightRays, TurnsInARowAskAllOfAForm) {
  const lighting::DistantLight d = strip(.4, .1);
  SamplePattern pattern;
  pattern.make(d, 4, 64);
  for (std::size_t first = 0; first + 4 <= 64; ++first) {
    std::array<int, 4> in{};
    for (std::size_t turn = first; turn < first + 4; ++turn)
      for (const glm::vec3& t : pattern.at(turn))
        ++in[static_cast<std::size_t>(4 * (t.x / t.y / .4f + .5f))];
    for (const int n : in) EXPECT_NEAR(n, 4, 1) << first;
  }
}

TEST(LightRays, WhatIsNarrowIsSoInEveryDirection) {
  lighting::DistantLight round;
  round.direction = {0, 1, 0};
  round.radius = Radians(.02);
  EXPECT_FALSE(is_wide(round));
  EXPECT_FALSE(is_wide(strip(.02, .05)));
  EXPECT_TRUE(is_wide(strip(.002, .4)));  // as long as it is thin
  round.radius = Radians(.06);
  EXPECT_TRUE(is_wide(round));
}

TEST(LightRays, RmsAngleIsTheCapsOrTheForms) {
  lighting::DistantLight round;
  round.direction = {0, 1, 0};
  round.radius = Radians(.1);
  EXPECT_NEAR(rms_angle(round), .1 / std::sqrt(2.), 1e-9);
  const lighting::DistantLight thin = strip(.002, .4);
  EXPECT_GT(rms_angle(thin), .15 / std::sqrt(3.));
  EXPECT_LT(rms_angle(thin), largest_angle(thin));
}

// The same lamp is smooth on a fine mesh and not on a coarse one; on one mesh a wide lamp is and a
// narrow one is not.
TEST(LightRays, NeighboursShareLightWhereEdgesAreShort) {
  const prt::Mesh fine = prt::make_knot(.5f, 320, 52, {}), coarse = prt::make_knot(.5f, 80, 16, {});
  lighting::DistantLight lamp;
  lamp.direction = {0, 1, 0};
  lamp.radius = Radians(.08);
  EXPECT_TRUE(penumbra_exceeds_edges(lamp, SilhouetteMesh(fine)));
  EXPECT_FALSE(penumbra_exceeds_edges(lamp, SilhouetteMesh(coarse)));
  EXPECT_TRUE(penumbra_exceeds_edges(lamp, SilhouetteMesh())) << "nothing to blur";
  lamp.radius = Radians(.02);
  EXPECT_FALSE(penumbra_exceeds_edges(lamp, SilhouetteMesh(fine)));
}

}  // namespace
}  // namespace penumbra::shadows
