// Points of equal energy in place of a source's pixels.
#include "lighting/lights/internal/light_shape.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "lighting/lighting.h"

namespace penumbra::lighting {
namespace {

using glm::dvec3;

// A band around the horizon's front, brighter towards one end.
std::vector<EnergyPiece> band(double brighter) {
  std::vector<EnergyPiece> out;
  for (int i = 0; i < 1024; ++i) {
    const double a = (i + .5) / 1024 - .5;
    for (const double up : {-.01, .01})
      out.push_back({1 + brighter * (a + .5), glm::normalize(dvec3(std::sin(a), up, std::cos(a)))});
  }
  return out;
}

double azimuth(const dvec3& d) {
  return std::atan2(d.x, d.z);
}

TEST(LightShape, EachPointStandsForASixtyFourthOfTheEnergy) {
  for (const double brighter : {0., 1., 30.}) {
    std::vector<EnergyPiece> parts = band(brighter);
    const std::vector<EnergyPiece> all = parts;
    const auto points = shape_points(parts);
    ASSERT_EQ(points.size(), std::size_t{DistantLight::kShapePoints});
    double weight = 0;
    for (const EnergyPiece& s : all) weight += s.weight;
    // Between the middles of neighbouring points lies as much energy, to a fraction at each end.
    std::vector<double> at;
    for (const dvec3& p : points) at.push_back(azimuth(p));
    std::ranges::sort(at);
    for (std::size_t k = 0; k + 4 < at.size(); k += 4) {
      double between = 0;
      for (const EnergyPiece& s : all)
        if (azimuth(s.direction) >= at[k] && azimuth(s.direction) < at[k + 4]) between += s.weight;
      EXPECT_NEAR(between / weight, 4. / 64, .015) << brighter << ", " << k;
    }
    dvec3 mean(0), found(0);
    for (const EnergyPiece& s : all) mean += s.weight / weight * s.direction;
    for (const dvec3& p : points) found += p / 64.;
    EXPECT_LT(glm::distance(mean, found), 3e-3) << brighter;
  }
}

// Each block of so many points is a piece of the band of its own.
TEST(LightShape, NeighboursAreInNeighbouringPlaces) {
  std::vector<EnergyPiece> parts = band(0);
  const auto points = shape_points(parts);
  for (const std::size_t block : {4u, 8u, 16u, 32u})
    for (std::size_t k = 0; k < points.size(); k += block) {
      double low = 1, high = -1;
      for (std::size_t i = k; i < k + block; ++i) {
        low = std::min(low, azimuth(points[i]));
        high = std::max(high, azimuth(points[i]));
      }
      EXPECT_LT(high - low, static_cast<double>(block) / 64 + .005) << block << ", " << k;
    }
}

// The order in which a map's pixels come says nothing about the source.
TEST(LightShape, IsTheSameFromSharesInAnyOrder) {
  std::vector<EnergyPiece> parts = band(2), other = parts;
  std::shuffle(other.begin(), other.end(), std::mt19937(3));
  const auto points = shape_points(parts), shuffled = shape_points(other);
  for (const dvec3& p : points) {
    double nearest = 1;
    for (const dvec3& q : shuffled) nearest = std::min(nearest, glm::distance(p, q));
    EXPECT_LT(nearest, 3e-3);
  }
}

TEST(LightShape, FewFractionsAreRepeated) {
  std::vector<EnergyPiece> one{{2, {0, 1, 0}}}, two{{1, {0, 1, 0}}, {1, {1, 0, 0}}};
  for (const dvec3& p : shape_points(one)) EXPECT_EQ(p, dvec3(0, 1, 0));
  const auto points = shape_points(two);
  EXPECT_EQ(std::ranges::count(points, dvec3(0, 1, 0)), 32);
  EXPECT_EQ(std::ranges::count(points, dvec3(1, 0, 0)), 32);
}

}  // namespace
}  // namespace penumbra::lighting
