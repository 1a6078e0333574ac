// Few patterns in the place of all coefficients.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/prt/transfers.h"
#include "tests/support/lights.h"

namespace penumbra::prt {
namespace {

using test::random_transfer;

std::vector<glm::dvec3> directions(int count) {
  std::vector<glm::dvec3> out;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2 * i + 1.) / count, a = i * 2.399963229728653, r = std::sqrt(1 - z * z);
    out.emplace_back(r * std::cos(a), r * std::sin(a), z);
  }
  return out;
}

// A light so small that all bands see it, of irradiance 1.
RadianceSh small_light(const glm::dvec3& direction, int bands) {
  double basis[kMaxCoefficients];
  lighting::evaluate_basis(bands, direction, basis);
  RadianceSh out(bands);
  for (int n = 0; n < out.size(); ++n)
    out[n] = Rgb{1, 1, 1} * static_cast<float>(basis[static_cast<std::size_t>(n)]);
  return out;
}

// Unshadowed surfaces that look everywhere.
Transfer convex(int bands, std::size_t points) {
  Transfer out(bands, 1, points);
  double basis[kMaxCoefficients];
  const std::vector<glm::dvec3> normals = directions(static_cast<int>(points));
  for (std::size_t p = 0; p < points; ++p) {
    lighting::evaluate_basis(bands, normals[p], basis);
    for (int l = 0, n = 0; l < bands; ++l)
      for (int m = -l; m <= l; ++m, ++n)
        out.set(0, n, p,
                static_cast<float>(lighting::cosine_coefficient(l) / kPi *
                                   basis[static_cast<std::size_t>(n)]));
  }
  return out;
}

BakedObject baked_knot(Rgb albedo) {
  Mesh mesh = make_knot(.5f, 96, 16, albedo);
  BakeOptions options;
  options.rays = options.ground_rays = 256;
  const GroundGrid grid = fit_ground_grid(mesh, bounds_of(mesh).low.y, 32);
  options.receiver = Receiver{grid, {.4f, .4f, .4f}};
  return *bake(std::move(mesh), options);
}

// RMS over points, colours and lights from everywhere of what components change, as a share of what faces the light.
double error_of(const TransferComponents& components, const Transfer& transfer) {
  std::vector<float> few(3 * transfer.stride), all(few.size());
  double sum = 0;
  const std::vector<glm::dvec3> from = directions(400);
  for (const glm::dvec3& d : from) {
    const RadianceSh light = small_light(d, transfer.bands);
    components.relight(light, few);
    relight(transfer, light, all);
    for (std::size_t i = 0; i < all.size(); ++i)
      sum += (double(few[i]) - all[i]) * (double(few[i]) - all[i]);
  }
  return kPi * std::sqrt(sum / (3. * static_cast<double>(transfer.points * from.size())));
}

TEST(TransferComponents, TheErrorIsAsAskedFor) {
  for (const Rgb albedo : {Rgb{.6f, .6f, .6f}, Rgb{.8f, .5f, .2f}}) {
    const BakedObject o = baked_knot(albedo);
    for (const Transfer* t : {&o.transfer, &o.indirect, &o.ground_deficit, &o.ground_indirect}) {
      const int all = coefficient_count(t->bands);
      int before = all;
      for (const double error : {3e-4, 1e-3, 5e-3}) {
        const TransferComponents c(*t, error);
        EXPECT_LE(error_of(c, *t), 1.02 * error + 2e-5);  // halves beside it
        EXPECT_LE(c.count(), before);
        before = c.count();
      }
      EXPECT_LT(before, .75 * all);
      // No more than is needed: with a tenth of the error more are kept.
      EXPECT_GT(TransferComponents(*t, 5e-4).count(), before);
    }
  }
}

// Odd bands of a cosine from the third on are zero.
TEST(TransferComponents, AConvexSurfaceHasAsManyAsItsCosine) {
  EXPECT_EQ(TransferComponents(convex(5, 2000), 1e-4).count(), 1 + 3 + 5 + 9);
  EXPECT_EQ(TransferComponents(convex(9, 4000), 1e-4).count(), 1 + 3 + 5 + 9 + 13 + 17);
}

TEST(TransferComponents, WhatIsIndependentKeepsAllCoefficients) {
  for (const int channels : {1, 3})
    for (const int bands : {1, 2, 5}) {
      const Transfer t = random_transfer(bands, channels, 300, 1);
      const TransferComponents c(t, 1e-3);
      EXPECT_EQ(c.count(), coefficient_count(bands));
      EXPECT_LE(error_of(c, t), 2e-3);  // halves of larger numbers
    }
}

TEST(TransferComponents, FollowLightsOfFewerAndMoreBands) {
  const Transfer t = convex(5, 500);
  const TransferComponents c(t, 1e-4);
  std::vector<float> few(3 * t.stride), all(few.size());
  for (const int bands : {1, 2, 5, 9}) {
    const RadianceSh light = test::random_light(bands, 3);
    c.relight(light, few);
    relight(t, light, all);
    for (std::size_t i = 0; i < all.size(); ++i) ASSERT_NEAR(few[i], all[i], 1e-3) << bands;
  }
}

TEST(TransferComponents, NothingGivesNothing) {
  std::vector<float> out(3 * 64, NAN);
  const Transfer dark(5, 3, 10);
  TransferComponents(dark, 1e-3).relight(test::random_light(5, 3), out);
  for (const float v : out) ASSERT_EQ(v, 0);
  std::vector<float> none;
  TransferComponents(Transfer(), 1e-3).relight(test::random_light(5, 3), none);
}

}  // namespace
}  // namespace penumbra::prt
