#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <random>
#include <vector>

#include "lighting/lighting.h"
#include "shadows/field/internal/triple_products.h"
#include "shadows/shadows.h"
#include "tests/support/lights.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;

glm::dmat3 random_turn(std::mt19937& rng) {
  std::normal_distribution<double> gauss;
  return glm::mat3_cast(glm::normalize(glm::dquat(gauss(rng), gauss(rng), gauss(rng), gauss(rng))));
}

glm::vec3 random_normal(std::mt19937& rng) {
  std::normal_distribution<float> gauss;
  return glm::normalize(glm::vec3(gauss(rng), gauss(rng), gauss(rng)));
}

std::vector<float> random_blocked(int bands, std::mt19937& rng) {
  std::normal_distribution<float> gauss(0, .5f);
  std::vector<float> blocked(static_cast<std::size_t>(coefficient_count(bands)));
  for (float& b : blocked) b = gauss(rng);
  return blocked;
}

std::vector<float> everything_blocked(int bands) {
  std::vector<float> blocked(static_cast<std::size_t>(coefficient_count(bands)), 0);
  blocked[0] = static_cast<float>(std::sqrt(4 * kPi));
  return blocked;
}

// What a cap of the sphere about `axis` blocks, in closed form.
std::vector<float> cap(int bands, const dvec3& axis, double cos_half) {
  std::vector<double> basis(static_cast<std::size_t>(coefficient_count(bands)));
  lighting::evaluate_basis(bands, axis, basis);
  std::vector<float> blocked;
  for (int l = 0; l < bands; ++l) {
    const auto n = static_cast<unsigned>(l);
    const double fraction =
        l == 0 ? 1 - cos_half
               : (std::legendre(n - 1, cos_half) - std::legendre(n + 1, cos_half)) / (2. * l + 1);
    for (int m = -l; m <= l; ++m)
      blocked.push_back(
          static_cast<float>(2 * kPi * fraction * basis[static_cast<std::size_t>(sh_index(l, m))]));
  }
  return blocked;
}

template <class A, class B>
double difference(const A& a, const B& b) {
  double largest = 0;
  for (int c = 0; c < 3; ++c) {
    const double d = std::abs(static_cast<double>(a[c]) - static_cast<double>(b[c]));
    if (!(d <= largest)) largest = d;  // NaN is the largest of all
  }
  return largest;
}

// ------------------------------------------------------------------------------------- products

double triple_product(int i, int j, int k) {
  return TripleProducts::get().value(i, j, k);
}

TEST(TripleProduct, WithTheConstantIsOrthonormality) {
  const double y0 = 1 / std::sqrt(4 * kPi);
  for (int i = 0; i < kMaxCoefficients; ++i)
    for (int j = 0; j < kMaxFieldBands * kMaxFieldBands; ++j) {
      ASSERT_NEAR(triple_product(i, j, 0), i == j ? y0 : 0, 1e-12) << i << ' ' << j;
      ASSERT_NEAR(triple_product(0, j, i), i == j ? y0 : 0, 1e-12) << i << ' ' << j;
    }
  for (int i = 0; i < kMaxCoefficients; ++i)
    for (int k = 0; k < kMaxCoefficients; ++k)
      ASSERT_NEAR(triple_product(i, 0, k), i == k ? y0 : 0, 1e-12) << i << ' ' << k;
}

TEST(TripleProduct, DoesNotDependOnTheOrder) {
  constexpr int kCount = kMaxFieldBands * kMaxFieldBands;
  int different = 0;
  for (int i = 0; i < kCount; ++i)
    for (int j = 0; j < kCount; ++j)
      for (int k = 0; k < kCount; ++k) {
        const double t = triple_product(i, j, k);
        ASSERT_NEAR(triple_product(j, k, i), t, 1e-12);
        ASSERT_NEAR(triple_product(k, j, i), t, 1e-12);
        different += t != 0;
      }
  EXPECT_GT(different, 500);
  EXPECT_LT(different, kCount * kCount * kCount / 4) << "most of them vanish";
}

TEST(TripleProduct, KnownValues) {
  const int z = sh_index(1, 0), zz = sh_index(2, 0);
  EXPECT_NEAR(triple_product(zz, zz, zz), std::sqrt(5 / kPi) / 7, 1e-12);
  EXPECT_NEAR(triple_product(z, z, zz), 1 / std::sqrt(5 * kPi), 1e-12);
  EXPECT_EQ(triple_product(z, z, z), 0);
}

// Slow but simple quadrature; an exact rule with one node too few fails at the highest degrees.
TEST(TripleProduct, EqualsBruteForce) {
  constexpr int kHeights = 4000, kAngles = 48;
  std::mt19937 rng(1);
  std::vector<std::array<int, 3>> triples = {{2, 2, 6}, {80, 24, 64}, {16, 20, 6}};
  for (int i = 0; i < 400; ++i)
    triples.push_back(
        {static_cast<int>(rng() % 81), static_cast<int>(rng() % 25), static_cast<int>(rng() % 81)});
  std::vector<double> sums(triples.size());
  double basis[kMaxCoefficients];
  for (int h = 0; h < kHeights; ++h)
    for (int a = 0; a < kAngles; ++a) {
      const double z = 2 * (h + .5) / kHeights - 1, r = std::sqrt(1 - z * z);
      const double phi = 2 * kPi * a / kAngles;
      lighting::evaluate_basis(kMaxBands, {r * std::cos(phi), r * std::sin(phi), z}, basis);
      for (std::size_t t = 0; t < triples.size(); ++t)
        sums[t] += basis[triples[t][0]] * basis[triples[t][1]] * basis[triples[t][2]];
    }
  int not_zero = 0;
  for (std::size_t t = 0; t < triples.size(); ++t) {
    const auto [i, j, k] = triples[t];
    const double brute = sums[t] * 4 * kPi / (double(kHeights) * kAngles);
    ASSERT_NEAR(triple_product(i, j, k), brute, 1e-5) << i << ' ' << j << ' ' << k;
    not_zero += std::abs(brute) > 1e-3;
  }
  EXPECT_GT(not_zero, 5);
}

// ------------------------------------------------------------------------------------- deficit

// One triple too few, or a basis function with the wrong sign, and turned things do not agree.
TEST(FieldLight, TurningEverythingChangesNothing) {
  std::mt19937 rng(2);
  for (const int bands : {1, 2, 3, 4, 5})
    for (int i = 0; i < 20; ++i) {
      const RadianceSh light = test::random_light(1 + i % kMaxBands, static_cast<unsigned>(i));
      const auto blocked = random_blocked(bands, rng);
      const glm::vec3 normal = random_normal(rng);
      const glm::dmat3 turn = random_turn(rng);
      const lighting::ShRotation rotation(turn, kMaxBands);
      RadianceSh coefficients(bands);
      for (int n = 0; n < coefficients.size(); ++n) {
        const float b = blocked[static_cast<std::size_t>(n)];
        coefficients[n] = {b, b, b};
      }
      std::vector<float> turned;
      const RadianceSh turned_coefficients = rotation * coefficients;
      for (const Rgb& b : turned_coefficients.terms()) turned.push_back(b.r);
      const FieldLight before(light, bands), after(rotation * light, bands);
      EXPECT_LT(difference(before.deficit(blocked, normal),
                           after.deficit(turned, glm::vec3(turn * dvec3(normal)))),
                1e-5);
      const RadianceSh seen = rotation * before.seen_through(blocked);
      const RadianceSh turned_seen = after.seen_through(turned);
      for (int n = 0; n < seen.size(); ++n)
        EXPECT_LT(difference(seen[n], turned_seen[n]), 1e-5) << n;
    }
}

TEST(FieldLight, EverythingBlockedTakesAllNothingBlockedNothing) {
  for (const int bands : {1, 3, 5})
    for (const int light_bands : {1, 4, 5}) {
      const RadianceSh light = test::random_light(light_bands, 3);
      const FieldLight field_light(light, bands);
      const auto all = everything_blocked(bands);
      const std::vector<float> none(all.size(), 0);
      for (const glm::vec3 n : {glm::vec3(0, 1, 0), glm::vec3(.6f, 0, -.8f)}) {
        EXPECT_LT(difference(field_light.deficit(all, n),
                             lighting::evaluate(lighting::irradiance(light), dvec3(n))),
                  1e-5);
        EXPECT_EQ(field_light.deficit(none, n), Rgb{});
      }
      EXPECT_EQ(field_light.seen_through(none), light);
      const RadianceSh dark = field_light.seen_through(all);
      for (const Rgb& l : dark.terms()) EXPECT_LT(difference(l, Rgb{}), 1e-5);
    }
}

// Slow quadrature of lobe times light times visibility. A light with more bands than the field and
// the cosine together see in it, or with its high bands dropped, fails.
TEST(FieldLight, DeficitIsTheIntegralOfTheTruncatedFunctions) {
  constexpr int kHeights = 1000, kAngles = 48;
  std::mt19937 rng(6);
  for (const int bands : {2, 5}) {
    const RadianceSh light = test::random_light(kMaxBands, 6, 1);
    const auto blocked = random_blocked(bands, rng);
    const glm::vec3 normal = random_normal(rng);
    double at_normal[25], basis[kMaxCoefficients], sum[3] = {};
    lighting::evaluate_basis(5, normal, at_normal);
    for (int h = 0; h < kHeights; ++h)
      for (int a = 0; a < kAngles; ++a) {
        const double z = 2 * (h + .5) / kHeights - 1, r = std::sqrt(1 - z * z);
        const double phi = 2 * kPi * a / kAngles;
        lighting::evaluate_basis(kMaxBands, {r * std::cos(phi), r * std::sin(phi), z}, basis);
        double lobe = 0, visibility = 0;
        for (int l = 0; l < 5; ++l)
          for (int m = -l; m <= l; ++m)
            lobe +=
                lighting::cosine_coefficient(l) * at_normal[sh_index(l, m)] * basis[sh_index(l, m)];
        for (std::size_t n = 0; n < blocked.size(); ++n)
          visibility += static_cast<double>(blocked[n]) * basis[n];
        for (int n = 0; n < light.size(); ++n)
          for (int c = 0; c < 3; ++c)
            sum[c] += lobe * visibility * basis[n] * static_cast<double>(light[n][c]);
      }
    const Rgb d = FieldLight(light, bands).deficit(blocked, normal);
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(d[c], sum[c] * 4 * kPi / (double(kHeights) * kAngles), 1e-3) << bands;
  }
}

// A cap overhead takes sin^2 of its half angle of a uniform sky. Tolerance: bands of the cosine
// beyond the fifth, and of the cap beyond the field's, are missing.
TEST(FieldLight, CapOverheadTakesItsShareOfAUniformSky) {
  const FieldLight light(test::constant_light({1, 2, 3}, 3), 5);
  for (const double half : {.2, .5, 1., kPi / 2}) {
    const Rgb d = light.deficit(cap(5, {0, 1, 0}, std::cos(half)), {0, 1, 0});
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(d[c], (c + 1) * kPi * std::pow(std::sin(half), 2), .02 * (c + 1) * kPi) << half;
    const Rgb below = light.deficit(cap(5, {0, -1, 0}, std::cos(half)), {0, 1, 0});
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(below[c], 0, .02 * (c + 1) * kPi) << half;
  }
}

// Blocking where the light comes from takes more than blocking elsewhere: mixing up the indices of
// light and visibility passes under a uniform sky, and fails here.
TEST(FieldLight, BlockingTheBrightSideTakesMost) {
  const FieldLight light(test::sloped_light(1, {.9, 0, 0}), 4);
  const auto taken = [&](const dvec3& axis) {
    return light.deficit(cap(4, glm::normalize(axis), .9), {0, 1, 0}).g;
  };
  const double cap_irradiance = kPi * (1 - .81) * std::sqrt(.5);  // under radiance 1, at 45 degrees
  EXPECT_NEAR(taken({1, 1, 0}), cap_irradiance * (1 + .9 * .95 * std::sqrt(.5)), .06);
  EXPECT_NEAR(taken({-1, 1, 0}), cap_irradiance * (1 - .9 * .95 * std::sqrt(.5)), .06);
}

// ------------------------------------------------------------------------------------- seen light

TEST(FieldLight, SeenLightLightsASurfaceAsTheDeficitSays) {
  std::mt19937 rng(4);
  for (const int bands : {2, 4, 5}) {
    const RadianceSh light = test::random_light(5, 5);
    const FieldLight field_light(light, bands);
    const auto blocked = cap(bands, dvec3(random_normal(rng)), .7);
    const IrradianceSh seen = lighting::irradiance(field_light.seen_through(blocked));
    const IrradianceSh open = lighting::irradiance(light);
    for (int i = 0; i < 20; ++i) {
      const glm::vec3 n = random_normal(rng);
      EXPECT_LT(difference(field_light.deficit(blocked, n),
                           lighting::evaluate(open, dvec3(n)) - lighting::evaluate(seen, dvec3(n))),
                1e-5);
    }
  }
}

// Two occluders, one after the other: what the first has taken the second cannot take again. Their
// sum, the naive way, takes everything under two half skies that are the same one.
TEST(FieldLight, OneOccluderAfterTheOtherDoesNotTakeTwice) {
  const auto half_sky = cap(5, {0, 1, 0}, 0);
  const RadianceSh light = test::constant_light({1, 1, 1}, 5);
  const RadianceSh once = FieldLight(light, 5).seen_through(half_sky);
  const RadianceSh twice = FieldLight(once, 5).seen_through(half_sky);
  EXPECT_NEAR(once[0].g / light[0].g, .5, 1e-5);
  EXPECT_NEAR(twice[0].g / light[0].g, .5, .07);  // five bands of the half sky's edge
}

}  // namespace
}  // namespace penumbra::shadows
