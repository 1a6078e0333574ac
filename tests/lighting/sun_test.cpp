#include "lighting/lights/sun.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"

namespace penumbra::lighting {
namespace {

using namespace std::chrono;

double degrees_apart(const glm::dvec3& a, const glm::dvec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b)) * 180 / kPi;
}

// Reda & Andreas 2004, table A5.1: 17 October 2003, 12:30:30 at UTC-7, 39.742476 N 105.1786 W.
// Topocentric, with refraction: zenith 50.11162, azimuth 194.34024 degrees.
TEST(SunDirection, IsThatOfThePublishedExample) {
  const SunSite site{39.742476, -105.1786, 0, sys_days{2003y / October / 17} + 19h + 30min + 30s};
  const double zenith = 50.11162 * kPi / 180, azimuth = 194.34024 * kPi / 180;
  const glm::dvec3 published(std::sin(zenith) * std::sin(azimuth), std::cos(zenith),
                             -std::sin(zenith) * std::cos(azimuth));
  const double off = degrees_apart(sun_direction(site), published);
  std::printf("%.4f degrees off\n", off);
  EXPECT_LT(off, .025);
}

// At the solstices it stands 23.44 degrees north and south of the equator's zenith, at the June one
// never below 23.44 degrees at the pole.
TEST(SunDirection, FollowsTheSeasonsAndTheDay) {
  const auto elevation = [](double latitude, sys_seconds utc) {
    return std::asin(sun_direction({latitude, 0, 0, {}}, utc).y) * 180 / kPi;
  };
  const auto highest = [&](double latitude, sys_days day) {
    double out = -90;
    for (minutes m{0}; m < 24h; m += 2min) out = std::max(out, elevation(latitude, day + m));
    return out;
  };
  EXPECT_NEAR(highest(50, 2026y / June / 21), 90 - 50 + 23.44, .1);
  EXPECT_NEAR(highest(50, 2026y / December / 21), 90 - 50 - 23.44, .1);
  EXPECT_NEAR(highest(-35, 2026y / December / 21), 90 - 35 + 23.44, .1);
  for (int hour = 0; hour < 24; ++hour)
    EXPECT_NEAR(elevation(90, sys_days{2026y / June / 21} + hours(hour)), 23.44, .1);
  // East in the morning, south at noon, west in the evening; north lies at -z.
  const auto at = [](hours utc) {
    return sun_direction({50, 0, 0, {}}, sys_days{2026y / March / 20} + utc);
  };
  EXPECT_GT(at(7h).x, .9);
  EXPECT_GT(at(12h).z, .6);
  EXPECT_LT(at(17h).x, -.9);
}

TEST(SunDirection, TurnsWithNorthClockwiseFromAbove) {
  const sys_seconds noon = sys_days{2026y / March / 20} + 12h;
  const glm::dvec3 open = sun_direction({50, 0, 0, {}}, noon);
  const glm::dvec3 turned = sun_direction({50, 0, 90, {}}, noon);  // north at +x: south is at -x
  EXPECT_LT(degrees_apart(turned, {-open.z, open.y, open.x}), 1e-9);
  EXPECT_NEAR(glm::length(open), 1, 1e-12);
}

TEST(SunDirection, WithoutATimeIsTheClocks) {
  const SunSite site{50, 8, 0, {}};
  const glm::dvec3 now = sun_direction(site, floor<seconds>(system_clock::now()));
  EXPECT_LT(degrees_apart(sun_direction(site), now), .1);
}

}  // namespace
}  // namespace penumbra::lighting
