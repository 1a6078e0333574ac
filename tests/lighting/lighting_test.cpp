#include "lighting/lighting.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <random>

namespace penumbra::lighting {
namespace {

using glm::dvec3;

Image<Rgb> make_map(int width, int height, auto radiance) {
  Image<Rgb> map(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      map.at(x, y) = radiance(latlong_direction(x + .5, y + .5, width, height));
  return map;
}

dvec3 random_direction(std::mt19937& rng) {
  std::normal_distribution<double> gauss;
  return glm::normalize(dvec3(gauss(rng), gauss(rng), gauss(rng)));
}

glm::dmat3 random_rotation(std::mt19937& rng) {
  std::normal_distribution<double> g;
  return glm::mat3_cast(glm::normalize(glm::dquat(g(rng), g(rng), g(rng), g(rng))));
}

double project_brute_force(const Image<Rgb>& map, int n, int channel) {
  double sum = 0, basis[kMaxCoefficients];
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      evaluate_basis(kMaxBands, latlong_direction(x + .5, y + .5, map.width(), map.height()),
                     basis);
      sum += latlong_solid_angle(y, map.width(), map.height()) * basis[n] * map.at(x, y)[channel];
    }
  return sum;
}

TEST(Basis, FirstBandsHaveTheStatedSigns) {
  double y[9];
  const dvec3 d = glm::normalize(dvec3(.3, -.5, .7));
  evaluate_basis(3, d, y);
  EXPECT_NEAR(y[0], .2820947918, 1e-9);
  EXPECT_NEAR(y[1], .4886025119 * d.y, 1e-9);
  EXPECT_NEAR(y[2], .4886025119 * d.z, 1e-9);
  EXPECT_NEAR(y[3], .4886025119 * d.x, 1e-9);
  EXPECT_NEAR(y[4], 1.0925484306 * d.x * d.y, 1e-9);
  EXPECT_NEAR(y[5], 1.0925484306 * d.y * d.z, 1e-9);
  EXPECT_NEAR(y[6], .3153915653 * (3 * d.z * d.z - 1), 1e-9);
  EXPECT_NEAR(y[7], 1.0925484306 * d.x * d.z, 1e-9);
  EXPECT_NEAR(y[8], .5462742153 * (d.x * d.x - d.y * d.y), 1e-9);
}

TEST(Basis, IsOrthonormal) {
  // Gauss-Legendre would be exact; a fine lat-long grid with exact row weights is close enough.
  constexpr int kWidth = 256, kHeight = 512;
  std::vector<double> gram(kMaxCoefficients * kMaxCoefficients);
  double y[kMaxCoefficients];
  for (int j = 0; j < kHeight; ++j)
    for (int i = 0; i < kWidth; ++i) {
      evaluate_basis(kMaxBands, latlong_direction(i + .5, j + .5, kWidth, kHeight), y);
      const double w = latlong_solid_angle(j, kWidth, kHeight);
      for (int a = 0; a < kMaxCoefficients; ++a)
        for (int b = 0; b <= a; ++b) gram[static_cast<std::size_t>(a * 81 + b)] += w * y[a] * y[b];
    }
  for (int a = 0; a < kMaxCoefficients; ++a)
    for (int b = 0; b <= a; ++b)
      ASSERT_NEAR(gram[static_cast<std::size_t>(a * 81 + b)], a == b, 1e-3) << a << ' ' << b;
}

TEST(Basis, BlockEqualsScalar) {
  std::mt19937 rng(3);
  float x[16], y[16], z[16], block[81 * 16];
  double scalar[81];
  dvec3 d[16];
  for (int i = 0; i < 16; ++i) {
    d[i] = random_direction(rng);
    x[i] = float(d[i].x), y[i] = float(d[i].y), z[i] = float(d[i].z);
  }
  evaluate_basis_block(9, x, y, z, block);
  for (int i = 0; i < 16; ++i) {
    evaluate_basis(9, d[i], scalar);
    for (int n = 0; n < 81; ++n) ASSERT_NEAR(block[n * 16 + i], scalar[n], 2e-5);
  }
}

TEST(ShProjection, ConstantRadianceGivesOnlyTermZero) {
  const auto map = make_map(128, 64, [](const dvec3&) { return Rgb{2, 1, .5f}; });
  const auto light = project_latlong(map, 9);
  ASSERT_TRUE(light);
  EXPECT_NEAR(light->light[0].r, 2 * std::sqrt(4 * kPi), 1e-5);
  EXPECT_NEAR(light->light[0].b, .5 * std::sqrt(4 * kPi), 1e-5);
  for (int n = 1; n < 81; ++n) ASSERT_NEAR(light->light[n].r, 0, 2e-3) << n;
  EXPECT_NEAR(evaluate(irradiance(light->light.with_bands(1)), {0, 1, 0}).r, 2 * kPi, 1e-5);
}

TEST(ShProjection, BasisImageGivesUnitVector) {
  for (int target : {0, 1, 2, 3, 5, 12, 31, 47, 80}) {
    const auto map = make_map(512, 256, [&](const dvec3& d) {
      double y[81];
      evaluate_basis(9, d, y);
      const auto v = static_cast<float>(y[target]);
      return Rgb{v, -v, 2 * v};
    });
    const auto light = project_latlong(map, 9);
    ASSERT_TRUE(light);
    for (int n = 0; n < 81; ++n)
      ASSERT_NEAR(light->light[n].b, n == target ? 2 : 0, 2e-3) << target;
  }
}

TEST(ShProjection, FoldedRowsEqualBruteForce) {
  std::mt19937 rng(7);
  std::lognormal_distribution<float> heavy(0, 2);
  for (const int width : {4, 20, 128, 256, 1024}) {  // tails of every vector length
    Image<Rgb> map(width, 32);
    for (Rgb& p : map.pixels()) p = {heavy(rng), heavy(rng), heavy(rng)};
    const auto light = project_latlong(map, 9);
    ASSERT_TRUE(light);
    const double scale = light->light[0].r;
    for (int n = 0; n < 81; ++n)
      for (int c = 0; c < 3; ++c)
        ASSERT_NEAR(light->light[n][c], project_brute_force(map, n, c), 1e-6 * scale)
            << width << ' ' << n;
  }
}

TEST(ShProjection, WidthNotDivisibleByFourWorks) {
  const auto map = make_map(30, 15, [](const dvec3& d) { return Rgb{float(1 + d.x), 1, 1}; });
  const auto light = project_latlong(map, 2);
  ASSERT_TRUE(light);
  EXPECT_NEAR(light->light[3].r, 4 * kPi / 3 * .4886025, 2e-2);
}

TEST(ShProjection, NonFinitePixelIsNamedAndNeverReachesTheLight) {
  auto map = make_map(64, 32, [](const dvec3&) { return Rgb{1, 1, 1}; });
  map.at(5, 3).g = NAN;
  auto light = project_latlong(map, 3);
  ASSERT_FALSE(light);
  EXPECT_EQ(light.error().code, ErrorCode::kNonFinite);
  EXPECT_NE(light.error().detail.find("5,3"), std::string::npos);
  map.at(5, 3).g = INFINITY;
  EXPECT_FALSE(project_latlong(map, 3));
}

TEST(ShProjection, AxisPatchesLandOnTheirAxis) {
  for (int axis = 0; axis < 3; ++axis)
    for (int sign : {-1, 1}) {
      dvec3 a(0);
      a[axis] = sign;
      const auto map = make_map(128, 64, [&](const dvec3& d) {
        return glm::dot(d, a) > .9 ? Rgb{1, 1, 1} : Rgb{};
      });
      const auto light = project_latlong(map, 2);
      ASSERT_TRUE(light);
      const dvec3 mean(light->light[3].r, light->light[1].r, light->light[2].r);
      EXPECT_GT(glm::dot(glm::normalize(mean), a), .999);
    }
}

TEST(Holes, NadirHoleLeavesConstantEnvironmentConstant) {
  Environment environment;
  environment.radiance = make_map(128, 64, [](const dvec3& d) {
    return d.y < -std::cos(20 * kPi / 180) ? Rgb{} : Rgb{1, 1, 1};
  });
  environment.confidence = Image<float>(128, 64, 1);
  for (std::size_t i = 0; i < environment.radiance.area(); ++i)
    if (environment.radiance.pixels()[i].r == 0) environment.confidence.pixels()[i] = 0;
  const auto estimate = LightEstimator({.bands = 3}).estimate(environment);
  ASSERT_TRUE(estimate);
  EXPECT_NEAR(estimate->light[0].r, std::sqrt(4 * kPi), .005 * std::sqrt(4 * kPi));
  EXPECT_NEAR(estimate->coverage, 1 - (1 - std::cos(20 * kPi / 180)) / 2, .005);
  // The naive sum loses the hole's fraction.
  const auto naive = project_latlong(environment.radiance, 3);
  ASSERT_TRUE(naive);
  EXPECT_LT(naive->light[0].r, .975 * std::sqrt(4 * kPi));
}

TEST(Holes, AlmostNothingSeenIsUndetermined) {
  Environment environment;
  environment.radiance = Image<Rgb>(64, 32, {1, 1, 1});
  environment.confidence = Image<float>(64, 32, 0);
  environment.confidence.at(3, 16) = 1;
  const auto estimate = LightEstimator({.bands = 3}).estimate(environment);
  ASSERT_FALSE(estimate);
  EXPECT_EQ(estimate.error().code, ErrorCode::kUndetermined);
}

// RMS error of what upright and tilted surfaces get from above the horizon, relative to the mean.
double error_above_horizon(const Image<Rgb>& map, const RadianceSh& light) {
  std::mt19937 rng(23);
  double square = 0, mean = 0;
  for (int i = 0; i < 40; ++i) {
    dvec3 normal = random_direction(rng);
    normal.y = std::abs(normal.y);
    double truth = 0, approximate = 0;
    for (int y = 0; y < map.height() / 2; ++y)
      for (int x = 0; x < map.width(); ++x) {
        const dvec3 d = latlong_direction(x + .5, y + .5, map.width(), map.height());
        const double w =
            latlong_solid_angle(y, map.width(), map.height()) * std::max(0., glm::dot(d, normal));
        truth += w * map.at(x, y).g;
        approximate += w * evaluate(light, d).g;
      }
    square += (approximate - truth) * (approximate - truth) / 40;
    mean += truth / 40;
  }
  return std::sqrt(square) / mean;
}

TEST(FloorLight, ConstantSkyOverAnyGroundIsConstant) {
  for (const float ground : {0.f, 1.f, 7.f}) {
    const auto map = make_map(256, 128, [&](const dvec3& d) {
      return d.y > 0 ? Rgb{1, 1, 1} : Rgb{ground, ground, ground};
    });
    const auto p = project_latlong(map, 9);
    ASSERT_TRUE(p);
    for (const int bands : {1, 3, 5, 9}) {
      const RadianceSh light = upper_hemisphere_light(p->upper_moments, bands);
      EXPECT_NEAR(light[0].r, std::sqrt(4 * kPi), .02) << bands;
      EXPECT_NEAR(evaluate(light, glm::normalize(dvec3(.3, .4, -.2))).r, 1, .02) << bands;
    }
  }
}

TEST(FloorLight, DarkGroundCostsTheWholeSphereProjectionPercentsAndThisNone) {
  const auto map = make_map(64, 32, [](const dvec3& d) {
    const auto v = static_cast<float>(d.y > 0 ? 1 + .5 * d.x + .3 * d.z * d.y : 0);
    return Rgb{v, v, v};
  });
  const auto p = project_latlong(map, 9);
  ASSERT_TRUE(p);
  EXPECT_GT(error_above_horizon(map, p->light.with_bands(5)), .03);
  EXPECT_LT(error_above_horizon(map, upper_hemisphere_light(p->upper_moments, 5)), .005);
}

TEST(FloorLight, OddRowsShareTheHorizonRow) {
  const auto even = make_map(64, 64, [](const dvec3& d) {
    return Rgb{float(2 + d.x), 1, float(1 + d.y)};
  });
  const auto odd = make_map(64, 65, [](const dvec3& d) {
    return Rgb{float(2 + d.x), 1, float(1 + d.y)};
  });
  const auto a = project_latlong(even, 4), b = project_latlong(odd, 4);
  ASSERT_TRUE(a && b);
  for (int n = 0; n < 16; ++n) EXPECT_NEAR(a->upper_moments[n].b, b->upper_moments[n].b, 2e-3);
}

TEST(FloorLight, HolesAreFilledLikeTheWholeSphere) {
  Environment environment;
  environment.radiance = Image<Rgb>(128, 64, {1, 1, 1});
  environment.confidence = Image<float>(128, 64, 1);
  for (int y = 0; y < 12; ++y)
    for (int x = 0; x < 128; ++x)
      environment.radiance.at(x, y) = {}, environment.confidence.at(x, y) = 0;
  const auto estimate = LightEstimator({.bands = 5}).estimate(environment);
  ASSERT_TRUE(estimate);
  EXPECT_NEAR(estimate->upper_hemisphere_light[0].r, std::sqrt(4 * kPi), .02);
  EXPECT_NEAR(evaluate(estimate->upper_hemisphere_light, {0, 1, 0}).r, 1, .02);
}

TEST(Rotation, ComposesAndIsOrthogonal) {
  std::mt19937 rng(11);
  const glm::dmat3 r1 = random_rotation(rng), r2 = random_rotation(rng);
  const ShRotation d1(r1, 9), d2(r2, 9), d12(r1 * r2, 9);
  for (int l = 0; l < 9; ++l)
    for (int m = -l; m <= l; ++m)
      for (int n = -l; n <= l; ++n) {
        double product = 0, gram = 0;
        for (int k = -l; k <= l; ++k) {
          product += d1.entry(l, m, k) * d2.entry(l, k, n);
          gram += d1.entry(l, m, k) * d1.entry(l, n, k);
        }
        ASSERT_NEAR(product, d12.entry(l, m, n), 1e-6);
        ASSERT_NEAR(gram, m == n, 1e-6);
      }
}

TEST(Rotation, RotateThenEvaluateEqualsEvaluateThenRotate) {
  std::mt19937 rng(13);
  std::normal_distribution<float> gauss;
  RadianceSh light(9);
  for (Rgb& t : light.terms()) t = {gauss(rng), gauss(rng), gauss(rng)};
  for (int i = 0; i < 20; ++i) {
    const glm::dmat3 r = random_rotation(rng);
    const RadianceSh rotated = ShRotation(r, 9) * light;
    const dvec3 d = random_direction(rng);
    EXPECT_NEAR(evaluate(rotated, d).g, evaluate(light, glm::transpose(r) * d).g, 1e-4);
  }
}

TEST(Irradiance, CosineCoefficientsAreThePublishedOnes) {
  const double expected[] = {kPi, 2 * kPi / 3, kPi / 4, 0, -kPi / 24, 0, kPi / 64, 0, -kPi / 128};
  for (int l = 0; l < 9; ++l) EXPECT_NEAR(cosine_coefficient(l), expected[l], 1e-12);
}

TEST(Irradiance, DeltaLightWithThreeBandsRingsByTheClosedForm) {
  // Unit delta light along +z: E(c) with 3 bands is 1.0625 at c = 1 and -.0396 at c = -8/15.
  RadianceSh light(3);
  double y[9];
  evaluate_basis(3, {0, 0, 1}, y);
  for (int n = 0; n < 9; ++n) light[n] = Rgb{1, 1, 1} * static_cast<float>(y[n]);
  const auto e = irradiance(light);
  EXPECT_NEAR(evaluate(e, {0, 0, 1}).r, 1.0625, 1e-5);
  double smallest = 1, where = 0;
  for (double c = -1; c <= 1; c += 1e-4)
    if (const double v = evaluate(e, {std::sqrt(1 - c * c), 0, c}).r; v < smallest)
      smallest = v, where = c;
  EXPECT_NEAR(smallest, -.0396, 1e-4);
  EXPECT_NEAR(where, -8. / 15, 2e-3);
}

TEST(Estimate, TruncationErrorFallsWithBandsAndIsZeroForConstantLight) {
  const auto map = make_map(128, 64, [](const dvec3& d) {
    return d.y > .95 ? Rgb{50, 50, 50} : Rgb{1, 1, 1};
  });
  const auto nine = project_latlong(map, 9);
  ASSERT_TRUE(nine);
  double last = 10;
  for (int bands = 1; bands <= 8; ++bands) {
    const double e = *make_estimate(*nine, bands).truncation_error;
    EXPECT_LE(e, last);
    last = e;
  }
  ShProjection constant{RadianceSh(9), RadianceSh(9), 1};
  constant.light[0] = {1, 1, 1};
  EXPECT_EQ(make_estimate(constant, 1).truncation_error, 0);
  EXPECT_FALSE(make_estimate(*nine, 9).truncation_error) << "nobody measured the bands beyond";
}

TEST(Estimate, VisibleChangeBoundsTheIrradianceChange) {
  std::mt19937 rng(5);
  std::normal_distribution<float> gauss(0, .02f);
  RadianceSh a(5);
  a[0] = {3, 3, 3};
  RadianceSh b = a;
  for (Rgb& t : b.terms()) t += Rgb{gauss(rng), gauss(rng), gauss(rng)};
  const double bound = largest_visible_change(a, b);
  const auto ea = irradiance(a), eb = irradiance(b);
  for (int i = 0; i < 200; ++i) {
    const dvec3 n = random_direction(rng);
    const double change = std::abs(evaluate(eb, n).r - evaluate(ea, n).r) / evaluate(ea, n).r;
    EXPECT_LE(change, bound);
  }
  EXPECT_EQ(largest_visible_change(a, a), 0);
}

}  // namespace
}  // namespace penumbra::lighting
