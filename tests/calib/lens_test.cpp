// Lenses with distortion against OpenCV 4.6 (fisheye::projectPoints, projectPoints), the double
// sphere's own equations, and solid angles by brute force.
#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "calib/calib.h"
#include "core/conventions.h"
#include "tests/calib/projections.h"

namespace penumbra::calib {
namespace {

CameraModel lens(ProjectionKind kind, std::vector<double> distortion, double focal = 240) {
  CameraModel p = projection(kind, 1000, 760);
  p.focal_px = {focal, focal * 1.01};
  p.principal_px = {494, 379};
  const auto out = with_distortion(p, distortion);
  EXPECT_TRUE(out) << out.error().detail;
  return out.value_or(p);
}

std::vector<CameraModel> lenses() {
  return {lens(kKannalaBrandt, {.03987, .03812, -.02952, .00739}),
          lens(kKannalaBrandt, {-.05, .01, 0, 0}),
          lens(kDoubleSphere, {-.18, .59}, 300),
          lens(kDoubleSphere, {.2, .4}),
          lens(kPinhole, {-.28, .07, .001, -.0005, .002}, 700),
          lens(kPinhole, {.1, -.02, 0, 0, 0}, 700)};
}

void expect_pixel(const CameraModel& p, const glm::dvec3& d, double x, double y) {
  const auto pixel = pixel_from_direction(p, d);
  ASSERT_TRUE(pixel);
  EXPECT_NEAR(pixel->x, x, 1e-7);
  EXPECT_NEAR(pixel->y, y, 1e-7);
}

// OpenCV's camera looks along +z with y down.
TEST(Lens, AgreesWithOpenCv) {
  CameraModel p = lens(kKannalaBrandt, {.03987, .03812, -.02952, .00739});
  p.focal_px = {437, 436};
  expect_pixel(p, {.3, .2, -1}, 620.4880595874, 294.8675911821);
  expect_pixel(p, {1.5, -1, -1}, 905.5180873503, 652.7175989088);
  p = lens(kPinhole, {-.28, .07, .001, -.0005, .002});
  p.focal_px = {437, 436};
  expect_pixel(p, {.3, .2, -1}, 620.3634523534, 294.9882592432);
  expect_pixel(p, {.6, -.4, -1}, 722.9991564352, 531.6190472704);
  expect_pixel(p, {-.1, -.5, -1}, 453.1681554576, 582.521999136);
}

// Usenko et al. 2018, eq. 40-42.
TEST(Lens, DoubleSphereIsThePapersFormula) {
  const double xi = -.18, alpha = .59;
  const CameraModel p = lens(kDoubleSphere, {xi, alpha});
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 200; ++i) {
    const double x = normal(random), y = normal(random), z = std::abs(normal(random));
    const double d1 = std::sqrt(x * x + y * y + z * z), back = xi * d1 + z;
    const double d2 = std::sqrt(x * x + y * y + back * back);
    const double denominator = alpha * d2 + (1 - alpha) * back;
    const glm::dvec2 expected = p.principal_px + p.focal_px * glm::dvec2(x, y) / denominator;
    const auto pixel = pixel_from_direction(p, {x, -y, -z});
    if (expected.x < 0 || expected.y < 0 || expected.x > p.width || expected.y > p.height) continue;
    ASSERT_TRUE(pixel);
    EXPECT_LT(glm::length(*pixel - expected), 1e-9);
  }
}

TEST(Lens, UndistortedKb4IsEquidistantAndSolidAngleToo) {
  const CameraModel a = lens(kEquidistant, {}), b = lens(kKannalaBrandt, {});
  const auto ta = make_projection_table(a), tb = make_projection_table(b);
  for (std::size_t i = 0; i < ta.direction.size(); i += 97) {
    EXPECT_LT(glm::length(ta.direction[i] - tb.direction[i]), 1e-6f);
    EXPECT_NEAR(ta.solid_angle_sr[i], tb.solid_angle_sr[i], 1e-5 * ta.solid_angle_sr[i]);
  }
}

TEST(Lens, RoundTrips) {
  std::mt19937 random(7);
  for (const CameraModel& p : lenses()) {
    std::uniform_real_distribution<double> x(0, p.width), y(0, p.height);
    int seen = 0;
    for (int i = 0; i < 2000; ++i) {
      const glm::dvec2 pixel{x(random), y(random)};
      const auto d = direction_from_pixel(p, pixel);
      if (!d) continue;
      ++seen;
      EXPECT_NEAR(glm::length(*d), 1, 1e-12);
      const auto back = pixel_from_direction(p, *d);
      ASSERT_TRUE(back) << name_of(p) << " " << pixel.x << " " << pixel.y;
      ASSERT_LT(glm::length(*back - pixel), 1e-6) << name_of(p);
    }
    EXPECT_GT(seen, 1200) << name_of(p);
  }
}

// A picture that a pixel would fold back into sees nothing there, rather than two directions.
TEST(Lens, NothingBeyondTheFold) {
  const CameraModel barrel = lens(kPinhole, {-.5, 0, 0, 0, 0}, 300);
  // r (1 - r^2 / 2) turns back at r^2 = 2/3, which is at radius .544.
  EXPECT_TRUE(pixel_from_direction(barrel, {.8, 0, -1}));
  EXPECT_FALSE(pixel_from_direction(barrel, {.83, 0, -1}));
  EXPECT_FALSE(direction_from_pixel(barrel, {494 + 300 * .55, 379}));
  EXPECT_TRUE(direction_from_pixel(barrel, {494 + 300 * .54, 379}));
}

// Up to the fold, however strong the lens: a step that only takes the error off diverges there.
TEST(Lens, StrongLensesInvertUpToTheirFold) {
  for (const std::vector<double>& k :
       {std::vector<double>{-.5, .1}, {.3, .2}, {-.3, .1}, {-.5, 0}, {.1, -.05, 0, 0, .01}}) {
    const CameraModel p = lens(kPinhole, k, 150);
    double last = -1;
    for (double angle = .01; angle < 1.4; angle += .01) {
      const glm::dvec3 d(std::sin(angle), 0, -std::cos(angle));
      const auto pixel = pixel_from_direction(p, d);
      if (!pixel) break;
      ASSERT_GT(pixel->x, last) << "two directions at one pixel, " << k[0] << " " << angle;
      last = pixel->x;
      const auto back = direction_from_pixel(p, *pixel);
      ASSERT_TRUE(back) << k[0] << " " << angle;
      EXPECT_LT(glm::length(*back - d), 1e-6) << k[0] << " " << angle;
    }
    EXPECT_GT(last, 494 + 150 * .5);
  }
}

double brute_force(const CameraModel& p, int px, int py) {
  constexpr int kN = 8;
  double sum = 0;
  for (int v = 0; v < kN; ++v) {
    for (int u = 0; u < kN; ++u) {
      const auto at = [&](int i, int j) {
        return direction_from_pixel(
            p, {px + static_cast<double>(u + i) / kN, py + static_cast<double>(v + j) / kN});
      };
      const auto a = at(0, 0), b = at(1, 0), c = at(0, 1);
      if (!a || !b || !c) return -1;
      sum += glm::length(glm::cross(*b - *a, *c - *a));
    }
  }
  return sum;
}

TEST(Lens, SolidAnglesAgreeWithBruteForce) {
  std::mt19937 random(11);
  for (const CameraModel& p : lenses()) {
    const ProjectionTable table = make_projection_table(p);
    std::uniform_int_distribution<int> x(0, p.width - 1), y(0, p.height - 1);
    int tried = 0;
    for (int i = 0; i < 300; ++i) {
      const int px = x(random), py = y(random);
      const auto n = static_cast<std::size_t>(py * p.width + px);
      const double expected = brute_force(p, px, py);
      if (expected < 0 || table.confidence[n] < 1) continue;
      ++tried;
      ASSERT_NEAR(table.solid_angle_sr[n], expected, 1e-3 * expected)
          << name_of(p) << " " << px << " " << py;
    }
    EXPECT_GT(tried, 150) << name_of(p);
  }
}

TEST(Lens, ImpossibleDistortionIsRefused) {
  const auto reason = [](ProjectionKind kind, std::vector<double> k) {
    const auto p = with_distortion(projection(kind, 100, 80), k);
    return p ? std::string() : p.error().detail;
  };
  EXPECT_NE(reason(kKannalaBrandt, {1, 2, 3, 4, 5}).find("5 distortion coefficients"),
            std::string::npos);
  EXPECT_NE(reason(kEquidistant, {.1}).find("at most 0"), std::string::npos);
  EXPECT_NE(reason(kPinhole, {NAN}).find("not finite"), std::string::npos);
  EXPECT_NE(reason(kDoubleSphere, {0, 1.5}).find("alpha"), std::string::npos);
  EXPECT_NE(reason(kDoubleSphere, {-1, .5}).find("xi"), std::string::npos);
  EXPECT_NE(reason(kKannalaBrandt, {-9}).find("not monotone"), std::string::npos);
  EXPECT_NE(reason(kPinhole, {-9}).find("not monotone"), std::string::npos);
  EXPECT_EQ(reason(kPinhole, {-.3, .1}), "");
}

}  // namespace
}  // namespace penumbra::calib
