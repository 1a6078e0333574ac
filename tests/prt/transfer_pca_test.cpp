// Few patterns in the place of all coefficients.
#include <gtest/gtest.h>

#include <cmath>
#include <utility>
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

// Exit radiance by the components, or by all coefficients, of either transfer alone.
enum class Which { kFirst, kSecond };
std::vector<float> relit(const TransferPca& c, Which which, const RadianceSh& light,
                         std::size_t stride) {
  std::vector<float> out(3 * stride, NAN);
  const RadianceSh none(1);
  which == Which::kFirst ? c.relight(light, nullptr, out) : c.relight(none, &light, out);
  return out;
}
std::vector<float> relit(const Transfer& t, const RadianceSh& light) {
  std::vector<float> out(3 * t.stride, NAN);
  relight(t, light, out);
  return out;
}

// RMS over points, colours and lights from everywhere of what components change, as a fraction of
// what faces the light.
double error_of(const TransferPca& components, Which which, const Transfer& transfer) {
  double sum = 0;
  const std::vector<glm::dvec3> from = directions(400);
  for (const glm::dvec3& d : from) {
    const RadianceSh light = small_light(d, transfer.bands);
    const std::vector<float> few = relit(components, which, light, transfer.stride),
                             all = relit(transfer, light);
    for (std::size_t i = 0; i < all.size(); ++i)
      sum += (double(few[i]) - all[i]) * (double(few[i]) - all[i]);
  }
  return kPi * std::sqrt(sum / (3. * static_cast<double>(transfer.points * from.size())));
}

TEST(TransferPca, TheErrorIsAsAskedFor) {
  for (const Rgb albedo : {Rgb{.6f, .6f, .6f}, Rgb{.8f, .5f, .2f}}) {
    const BakedObject o = baked_knot(albedo);
    for (const auto& [first, second] : {std::pair{&o.transfer, &o.reflected},
                                        std::pair{&o.ground_deficit, &o.ground_reflected}}) {
      const int one = coefficient_count(first->bands), two = coefficient_count(second->bands);
      int first_before = one, before = one + two;
      for (const double error : {3e-4, 1e-3, 5e-3}) {
        const TransferPca c(*first, *second, error);
        EXPECT_LE(error_of(c, Which::kFirst, *first), 1.02 * error + 2e-5);  // halves beside it
        EXPECT_LE(error_of(c, Which::kSecond, *second), 1.02 * error + 4e-5);
        EXPECT_LE(c.first_count(), first_before);
        EXPECT_LE(c.count(), before);
        first_before = c.first_count(), before = c.count();
      }
      EXPECT_LT(first_before, .75 * one);
      EXPECT_LT(before, .5 * (one + two));
      // No more than is needed: with a tenth of the error more are kept.
      EXPECT_GT(TransferPca(*first, *second, 5e-4).first_count(), first_before);
    }
  }
}

TEST(TransferPca, EachHasItsOwn) {
  const BakedObject o = baked_knot({.6f, .6f, .6f});
  const TransferPca both(o.transfer, o.reflected, 5e-4), own(o.transfer, {}, 5e-4),
      reflected(o.reflected, {}, 5e-4);
  EXPECT_EQ(both.first_count(), own.count());
  EXPECT_EQ(both.count(), own.count() + reflected.count());
}

TEST(TransferPca, BothLightsAddUp) {
  const BakedObject o = baked_knot({.8f, .5f, .2f});
  const TransferPca c(o.transfer, o.reflected, 1e-4);
  const RadianceSh light = test::random_light(5, 3), more = test::random_light(9, 4);
  std::vector<float> both(3 * o.transfer.stride, NAN);
  c.relight(light, &more, both);
  const std::vector<float> one = relit(o.transfer, light), two = relit(o.reflected, more);
  double square = 0;
  for (std::size_t i = 0; i < both.size(); ++i) {
    const double off = double(both[i]) - (one[i] + two[i]);
    ASSERT_NEAR(off, 0, .01);
    square += off * off;
  }
  EXPECT_LT(std::sqrt(square / double(both.size())), 1e-3);

  std::vector<float> first(both.size(), NAN), second(both.size(), NAN);
  c.relight(light, nullptr, first);
  c.relight_second(more, second);
  for (std::size_t i = 0; i < both.size(); ++i)
    ASSERT_NEAR(first[i] + second[i], both[i], 1e-5 * std::max(1.f, std::abs(both[i])));
}

// A grey transfer beside one that differs by colour: an object whose shadows were taken off it.
TEST(TransferPca, GreyAndColouredGoTogether) {
  for (const int channels : {1, 3}) {
    const Transfer grey = random_transfer(2, channels, 300, 1),
                   coloured = random_transfer(3, 4 - channels, 300, 2);
    const TransferPca c(grey, coloured, 1e-3);
    EXPECT_EQ(c.count(), 4 + 9);
    EXPECT_LE(error_of(c, Which::kFirst, grey), 2e-3);  // halves of larger numbers
    EXPECT_LE(error_of(c, Which::kSecond, coloured), 4e-3);
  }
}

// Odd bands of a cosine from the third on are zero.
TEST(TransferPca, AConvexSurfaceHasAsManyAsItsCosine) {
  EXPECT_EQ(TransferPca(convex(5, 2000), {}, 1e-4).count(), 1 + 3 + 5 + 9);
  EXPECT_EQ(TransferPca(convex(9, 4000), {}, 1e-4).count(), 1 + 3 + 5 + 9 + 13 + 17);
}

TEST(TransferPca, WhatIsIndependentKeepsAllCoefficients) {
  for (const int channels : {1, 3})
    for (const int bands : {1, 2, 5}) {
      const Transfer t = random_transfer(bands, channels, 300, 1);
      const TransferPca c(t, {}, 1e-3);
      EXPECT_EQ(c.count(), coefficient_count(bands));
      EXPECT_LE(error_of(c, Which::kFirst, t), 2e-3);  // halves of larger numbers
    }
}

TEST(TransferPca, FollowLightsOfFewerAndMoreBands) {
  const Transfer t = convex(5, 500), more = convex(3, 500);
  const TransferPca c(t, more, 1e-4);
  for (const int bands : {1, 2, 5, 9}) {
    const RadianceSh light = test::random_light(bands, 3);
    for (const auto& [which, of] :
         {std::pair{Which::kFirst, &t}, std::pair{Which::kSecond, &more}}) {
      const std::vector<float> few = relit(c, which, light, t.stride), all = relit(*of, light);
      for (std::size_t i = 0; i < all.size(); ++i) ASSERT_NEAR(few[i], all[i], 1e-3) << bands;
    }
  }
}

TEST(TransferPca, NothingGivesNothing) {
  const RadianceSh light = test::random_light(5, 3);
  const Transfer dark(5, 3, 10);
  const TransferPca c(dark, dark, 1e-3);
  EXPECT_EQ(c.count(), 0);
  for (const Which which : {Which::kFirst, Which::kSecond})
    for (const float v : relit(c, which, light, dark.stride)) ASSERT_EQ(v, 0);
  EXPECT_EQ(TransferPca({}, {}, 1e-3).count(), 0);
  EXPECT_TRUE(relit(TransferPca({}, {}, 1e-3), Which::kSecond, light, 0).empty());
}

TEST(TransferPca, ADarkOneBesideOneThatIsNot) {
  const Transfer dark(5, 1, 500), lit = convex(3, 500);
  EXPECT_LE(error_of(TransferPca(dark, lit, 1e-4), Which::kSecond, lit), 2e-4);
}

}  // namespace
}  // namespace penumbra::prt
