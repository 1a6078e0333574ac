#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <random>

#include "calib/calib.h"
#include "core/conventions.h"
#include "tests/calib/projections.h"

namespace penumbra::calib {
namespace {

double sum_of(const ProjectionTable& table) {
  double sum = 0;
  for (const float w : table.solid_angle_sr) sum += w;
  return sum;
}

TEST(ProjectionTable, WholeSphereSolidAnglesSumToFourPi) {
  for (const int scale : {1, 2, 7, 64, 200})
    for (const CameraModel& p : whole_spheres(scale))
      EXPECT_NEAR(sum_of(make_projection_table(p)) / (4 * kPi), 1, 2.5e-7) << name_of(p);
}

TEST(ProjectionTable, FirstMomentIsZeroAndSecondIsIsotropic) {
  for (const CameraModel& p : whole_spheres(128)) {
    const ProjectionTable table = make_projection_table(p);
    glm::dvec3 first(0);
    glm::dmat3 second(0);
    for (std::size_t i = 0; i < table.direction.size(); ++i) {
      const glm::dvec3 d(table.direction[i]);
      ASSERT_NEAR(glm::length(d), 1, 1e-6) << name_of(p);
      first += d * static_cast<double>(table.solid_angle_sr[i]);
      second += glm::outerProduct(d, d) * static_cast<double>(table.solid_angle_sr[i]);
    }
    // Directions are those of pixel centres, so the moments err with the square of a pixel's width.
    EXPECT_LT(glm::length(first), 2e-3) << name_of(p);
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b)
        EXPECT_NEAR(second[a][b], a == b ? 4 * kPi / 3 : 0, 2e-3) << name_of(p) << " " << a << b;
  }
}

TEST(ProjectionTable, DirectionsAreThoseOfPixelCentres) {
  for (const CameraModel& p : all_kinds()) {
    const ProjectionTable table = make_projection_table(p);
    for (int y = 0; y < p.height; y += 7) {
      for (int x = 0; x < p.width; x += 5) {
        const auto d = direction_from_pixel(p, {x + .5, y + .5});
        const auto n = static_cast<std::size_t>(y * p.width + x);
        if (d) {
          ASSERT_LT(glm::length(*d - glm::dvec3(table.direction[n])), 1e-6) << name_of(p);
          ASSERT_GT(table.confidence[n], 0) << name_of(p);
        }
        if (table.confidence[n] == 0) {
          ASSERT_EQ(table.solid_angle_sr[n], 0) << name_of(p);
        }
      }
    }
  }
}

/// Solid angle of a pixel by brute force: sub-pixels as spherical triangles' flat limit.
double brute_force(const CameraModel& p, int x, int y, int parts) {
  double sum = 0;
  const double h = 1. / parts;
  for (int j = 0; j < parts; ++j) {
    for (int i = 0; i < parts; ++i) {
      const glm::dvec2 c{x + (i + .5) * h, y + (j + .5) * h};
      const double e = h / 4;
      const auto l = direction_from_pixel(p, c - glm::dvec2{e, 0}),
                 r = direction_from_pixel(p, c + glm::dvec2{e, 0});
      const auto t = direction_from_pixel(p, c - glm::dvec2{0, e}),
                 b = direction_from_pixel(p, c + glm::dvec2{0, e});
      if (!l || !r || !t || !b) continue;
      sum +=
          glm::length(glm::cross(*r - *l, *b - *t)) * 4;  // (2 e)^2 is a quarter of the sub-pixel
    }
  }
  return sum;
}

TEST(ProjectionTable, SolidAnglesAgreeWithBruteForce) {
  std::mt19937 random(11);
  for (const CameraModel& p : all_kinds()) {
    if (p.kind == kExrCube || p.kind == kExrLatLong)
      continue;  // their pixels reach outside at edges
    const ProjectionTable table = make_projection_table(p);
    std::uniform_int_distribution<int> x(0, p.width - 1), y(0, p.height - 1);
    for (int i = 0; i < 200; ++i) {
      const int px = x(random), py = y(random);
      const auto n = static_cast<std::size_t>(py * p.width + px);
      const double expected = brute_force(p, px, py, 24);
      if (table.confidence[n] < 1) continue;  // brute force is coarse at a rim
      ASSERT_NEAR(table.solid_angle_sr[n], expected, 2e-4 * expected + 1e-9)
          << name_of(p) << " " << px << " " << py;
    }
  }
}

TEST(ProjectionTable, ConfidenceIsTheCoveredPartOfAPixel) {
  for (const CameraModel& p : whole_spheres(7)) {
    if (p.kind == kExrCube || p.kind == kExrLatLong) continue;
    const ProjectionTable table = make_projection_table(p);
    constexpr int parts = 64;
    for (int y = 0; y < p.height; ++y) {
      for (int x = 0; x < p.width; ++x) {
        int seen = 0;
        for (int k = 0; k < parts * parts; ++k)
          seen +=
              direction_from_pixel(p, {x + (k % parts + .5) / parts, y + (k / parts + .5) / parts})
                  .has_value();
        ASSERT_NEAR(table.confidence[static_cast<std::size_t>(y * p.width + x)],
                    static_cast<double>(seen) / (parts * parts), 3e-3)
            << name_of(p) << " " << x << " " << y;
      }
    }
  }
}

TEST(ProjectionTable, MirrorBallIsEqualAreaAndRimPixelsCountTheirPart) {
  const CameraModel p = projection(kMirrorBall, 64, 64);
  const ProjectionTable table = make_projection_table(p);
  for (std::size_t i = 0; i < table.solid_angle_sr.size(); ++i)
    ASSERT_NEAR(table.solid_angle_sr[i], 4. / (32 * 32) * table.confidence[i], 1e-9);
  EXPECT_EQ(table.confidence[0], 0);
  const float rim = table.confidence[static_cast<std::size_t>(9 * 64 + 9)];  // cut by the circle
  EXPECT_GT(rim, 0);
  EXPECT_LT(rim, 1);
}

TEST(ProjectionTable, ExrEdgePixelsAreHalvesAndQuarters) {
  const ProjectionTable cube = make_projection_table(projection(kExrCube, 3, 18));
  // Lines at -1, -.5, .5, 1: the quarter, half and full cells of a face of 3 pixels.
  const auto omega = [](double x, double y) {
    return std::atan2(x * y, std::sqrt(1 + x * x + y * y));
  };
  EXPECT_NEAR(cube.solid_angle_sr[4], 4 * omega(.5, .5), 1e-6);
  EXPECT_NEAR(cube.solid_angle_sr[1], 2 * (omega(.5, 1) - omega(.5, .5)), 1e-6);
  EXPECT_NEAR(cube.solid_angle_sr[0], omega(1, 1) - 2 * omega(.5, 1) + omega(.5, .5), 1e-6);
  const ProjectionTable latlong = make_projection_table(projection(kExrLatLong, 5, 3));
  EXPECT_NEAR(latlong.solid_angle_sr[1], kPi / 2 * (1 - std::cos(kPi / 4)), 1e-6);
  EXPECT_NEAR(latlong.solid_angle_sr[5], kPi / 4 * 2 * std::cos(kPi / 4), 1e-6);
  EXPECT_NEAR(latlong.solid_angle_sr[6], kPi / 2 * 2 * std::cos(kPi / 4), 1e-6);
}

TEST(ProjectionTable, PinholeSolidAngleIsThatOfItsFrustum) {
  const CameraModel p = projection(kPinhole, 200, 100);
  const double x = 100 / p.focal_px.x, y = 50 / p.focal_px.y;
  EXPECT_NEAR(sum_of(make_projection_table(p)), 4 * std::atan2(x * y, std::sqrt(1 + x * x + y * y)),
              1e-6);
}

TEST(ProjectionTable, HemisphereFisheyeSumsToTwoPiWithinItsCircle) {
  CameraModel p = projection(kEquidistant, 300, 300);
  const ProjectionTable table = make_projection_table(p);
  double front = 0;
  for (std::size_t i = 0; i < table.direction.size(); ++i)
    if (table.direction[i].z <= 0) front += table.solid_angle_sr[i];
  EXPECT_NEAR(front, 2 * kPi, .03);  // pixels on the border count by their centre
}

}  // namespace
}  // namespace penumbra::calib
