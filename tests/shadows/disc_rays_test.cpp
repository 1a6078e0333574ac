#include "shadows/disc_rays.h"

#include <gtest/gtest.h>

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

TEST(DiscRays, TurnsTakeEveryDirectionInTheEnd) {
  const lighting::Disc d = strip(.1, .4);
  TapPattern pattern;
  pattern.make(d, 4, 16);
  std::map<std::pair<float, float>, int> seen;
  for (std::size_t turn = 0; turn < 16; ++turn)
    for (const glm::vec3& t : pattern.at(turn)) ++seen[{t.x, t.z}];
  EXPECT_EQ(seen.size(), 64u);
  for (const auto& [direction, times] : seen) EXPECT_EQ(times, 1);
}

}  // namespace
}  // namespace penumbra::shadows
