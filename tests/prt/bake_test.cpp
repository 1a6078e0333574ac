#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <glm/gtc/matrix_transform.hpp>
#include <optional>
#include <vector>

#include "lighting/lighting.h"
#include "prt/prt.h"
#include "prt/rays/ray_pattern.h"
#include "tests/prt/bowl.h"
#include "tests/support/lights.h"

namespace penumbra::prt {
namespace {

using test::Bowl;
using test::constant_light;
using test::make_bowl;

constexpr Rgb kWhite{1, 1, 1}, kBlack{0, 0, 0};
constexpr float kHalfStep = 0x1p-11f;  // largest relative rounding error of a half float

BakeOptions settings(int bands, int bounces, int rays, std::optional<Receiver> receiver = {},
                     int ground_rays = 1024) {
  BakeOptions options;
  options.bands = bands;
  options.bounces = bounces;
  options.rays = rays;
  options.ground_rays = ground_rays;
  options.receiver = receiver;
  return options;
}

// By rays that the cosine spreads, and by what vertices see: the laws are the same.
std::array<BakeOptions, 2> both_ways(const BakeOptions& options) {
  std::array<BakeOptions, 2> out{options, options};
  out[1].visibility = true;
  return out;
}

BakedObject baked(Mesh mesh, const BakeOptions& options) {
  auto object = bake(std::move(mesh), options);
  EXPECT_TRUE(object) << (object ? "" : object.error().detail);
  return object ? std::move(*object) : BakedObject{};
}

std::vector<float> relit(const Transfer& transfer, const RadianceSh& light) {
  std::vector<float> out(3 * transfer.stride, NAN);
  relight(transfer, light, out);
  out.resize(transfer.points);  // the red channel
  return out;
}

double open_transfer(int n, const glm::vec3& normal) {
  double basis[kMaxCoefficients];
  lighting::evaluate_basis(kMaxBands, glm::normalize(glm::dvec3(normal)), basis);
  const int l = static_cast<int>(std::sqrt(static_cast<double>(n)));
  return lighting::cosine_coefficient(l) / kPi * basis[n];
}

Mesh grey_knot(float albedo) {
  return make_knot(1, 120, 24, {albedo, albedo, albedo});
}

// ------------------------------------------------------------------------------------- convex

void expect_closed_form(const Mesh& mesh, const BakeOptions& options) {
  const BakedObject object = baked(mesh, options);
  ASSERT_EQ(object.transfer.points, mesh.positions.size());
  for (std::size_t p = 0; p < object.transfer.points; ++p)
    for (int n = 0; n < coefficient_count(options.bands); ++n) {
      const double expected = open_transfer(n, mesh.normals[p]);
      ASSERT_NEAR(object.transfer.value(0, n, p), expected, kHalfStep * std::abs(expected) + 1e-6)
          << "vertex " << p << " coefficient " << n;
    }
  EXPECT_EQ(object.report.standard_error, 0);
}

TEST(Bake, ConvexMeshHasTheClosedForm) {
  const BakeOptions options = settings(9, 2, 128);
  expect_closed_form(make_sphere({.1f, .5f, -.2f}, .7f, 3, kWhite), options);
  expect_closed_form(make_sphere({0, 0, 0}, 1, 0, kWhite), options);
  expect_closed_form(make_box({-1, 0, -.5f}, {1, .3f, .5f}, 4, kWhite), options);
}

TEST(Bake, WhiteFurnaceOnConvexMeshGivesOne) {
  for (const Mesh& mesh :
       {make_sphere({0, 1, 0}, 1, 3, kWhite), make_box({-1, 0, -1}, {1, 2, 1}, 3, kWhite)}) {
    const BakedObject object = baked(mesh, settings(3, 4, 64));
    for (const float v : relit(object.transfer, constant_light(kWhite)))
      ASSERT_NEAR(v, 1, kHalfStep);
  }
}

// ------------------------------------------------------------------------------------- bounces

TEST(Bake, WhiteFurnaceClosesOnAnyShapeAfterManyBounces) {
  // With albedo 1 nothing is lost, so each surface of an open shape glows like the sky; the sampled
  // equations have the same solution, hence no Monte Carlo error.
  for (const BakeOptions& options : both_ways(settings(2, 60, 64)))
    for (const float v : relit(baked(grey_knot(1), options).transfer, constant_light(kWhite)))
      ASSERT_NEAR(v, 1, 2 * kHalfStep) << options.visibility;
}

TEST(Bake, AFewBouncesStandForAll) {
  const auto lit = [](int bounces) {
    return relit(baked(grey_knot(.8f), settings(1, bounces, 64)).transfer, constant_light(kWhite));
  };
  const auto all = lit(60), none = lit(0), one = lit(1);
  const auto miss = [&](const std::vector<float>& some) {
    double square = 0;
    for (std::size_t i = 0; i < all.size(); ++i) square += std::pow(double(some[i]) - all[i], 2);
    return std::sqrt(square / static_cast<double>(all.size()));
  };
  for (std::size_t i = 0; i < all.size(); ++i) {
    ASSERT_GE(one[i], none[i]) << "a bounce only adds";
    ASSERT_GE(all[i], one[i] - kHalfStep);
    ASSERT_TRUE(all[i] >= 0 && all[i] <= 1 + kHalfStep) << all[i];
  }
  EXPECT_GT(miss(one), .02) << "cut off";
  EXPECT_LT(miss(lit(3)), .002) << "continued";
}

TEST(Bake, BlackSurfacesReflectNothing) {
  const Transfer direct = baked(grey_knot(0), settings(3, 0, 64)).transfer;
  EXPECT_EQ(direct.values, baked(grey_knot(0), settings(3, 3, 64)).transfer.values);
}

TEST(Bake, ColouredAlbedoActsPerChannel) {
  for (const BakeOptions& options : both_ways(settings(3, 4, 64))) {
    const BakedObject coloured = baked(make_knot(1, 60, 12, {.9f, .5f, 0}), options);
    ASSERT_EQ(coloured.transfer.channels, 3);
    int channel = 0;
    for (const float albedo : {.9f, .5f, 0.f}) {
      const BakedObject grey = baked(make_knot(1, 60, 12, {albedo, albedo, albedo}), options);
      ASSERT_EQ(grey.transfer.channels, 1) << "one channel serves all colours of grey";
      for (int n = 0; n < 9; ++n)
        for (std::size_t p = 0; p < grey.transfer.points; ++p)
          ASSERT_EQ(coloured.transfer.value(channel, n, p), grey.transfer.value(0, n, p));
      ++channel;
    }
  }
}

// ------------------------------------------------------------------------------------- bowl

TEST(Bake, BowlUnderConstantLightGlowsByTheClosedForm) {
  for (const auto& [cut, rho] : {std::pair{.6f, .8f}, {0.f, .5f}, {.9f, .3f}})
    for (const BakeOptions& options : both_ways(settings(1, 20, 1024))) {
      SCOPED_TRACE(options.visibility);
      const Bowl bowl = make_bowl(cut, rho);
      const BakedObject object = baked(bowl.mesh, options);
      const auto e =
          relit(object.transfer, constant_light(kWhite));  // E/pi; exit radiance is rho times it
      const double f = bowl.fraction, expected = (1 - f) / (1 - rho * f);
      double mean = 0;
      for (std::size_t i = 0; i < e.size(); ++i) {
        // A vertex has the noise of its own rays; over the bowl it averages out.
        ASSERT_NEAR(e[i], expected, .012) << "f " << f << " rho " << rho << " vertex " << i;
        mean += bowl.vertex_fraction[i] * e[i];
      }
      EXPECT_NEAR(mean, expected, .002 * expected) << "f " << f << " rho " << rho;
    }
}

TEST(Bake, BowlSpreadsWhatItReflectsEvenlyUnderAnyLight) {
  constexpr float kRho = .7f;
  const Bowl bowl = make_bowl(.3f, kRho);
  const RadianceSh light = test::sloped_light(1, {.5, .6, -.4});
  for (const BakeOptions& none : both_ways(settings(2, 0, 1024))) {
    SCOPED_TRACE(none.visibility);
    BakeOptions many = none;
    many.bounces = 20;
    const auto direct = relit(baked(bowl.mesh, none).transfer, light);
    const auto all = relit(baked(bowl.mesh, many).transfer, light);
    double mean_direct = 0;
    for (std::size_t i = 0; i < direct.size(); ++i)
      mean_direct += bowl.vertex_fraction[i] * direct[i];
    const double f = bowl.fraction, reflected = kRho * f * mean_direct / (1 - kRho * f);
    for (std::size_t i = 0; i < direct.size(); ++i)
      EXPECT_NEAR(all[i] - direct[i], reflected, .02 * reflected) << "vertex " << i;
  }
}

// ------------------------------------------------------------------------------------- receiver

TEST(Bake, SphereTakesItsClosedFormFromTheFloor) {
  for (const float height :
       {1.f, 1.3f, 2.5f}) {  // of the centre, in radii: resting, just above, hovering
    constexpr float kRadius = .25f;
    const Mesh sphere = make_sphere({.3f, 1 + height * kRadius, -.1f}, kRadius, 4, kBlack);
    const GroundGrid grid = fit_ground_grid(sphere, 1, 48);
    const BakedObject object = baked(sphere, settings(1, 1, 64, Receiver{grid, kBlack}, 2048));
    const auto deficit = relit(object.ground_deficit, constant_light(kWhite));
    for (int j = 0; j < grid.size; ++j)
      for (int i = 0; i < grid.size; ++i) {
        const glm::vec2 at = grid.position((glm::vec2(i, j) + .5f) / static_cast<float>(grid.size));
        const double d = glm::length(glm::dvec3(at.x - .3, height * kRadius, at.y + .1)) / kRadius;
        EXPECT_NEAR(deficit[static_cast<std::size_t>(j * grid.size + i)], height / (d * d * d), .01)
            << "height " << height << " texel " << i << ',' << j;
      }
  }
}

TEST(Bake, BlackFloorHidesTheLowerHemisphere) {
  const Mesh sphere = make_sphere({0, 2, 0}, .5f, 2, kBlack);
  for (const BakeOptions& options :
       both_ways(settings(1, 0, 1024, Receiver{fit_ground_grid(sphere, 0, 8), kBlack}))) {
    const auto e = relit(baked(sphere, options).transfer, constant_light(kWhite));
    for (std::size_t i = 0; i < e.size(); ++i)
      EXPECT_NEAR(e[i], (1 + sphere.normals[i].y) / 2, .01) << "vertex " << i;
  }
}

TEST(Bake, WhiteFurnaceClosesBetweenObjectAndFloor) {
  const Mesh knot = make_knot(1, 60, 12, kWhite);
  const Receiver floor{fit_ground_grid(knot, 0, 24), kWhite};
  for (const BakeOptions& options : both_ways(settings(1, 60, 64, floor, 64))) {
    const BakedObject object = baked(knot, options);
    for (const float v : relit(object.transfer, constant_light(kWhite))) ASSERT_NEAR(v, 1, .005);
    for (const float v : relit(object.ground_deficit, constant_light(kWhite)))
      ASSERT_NEAR(v, 0, .005);
  }
}

// What lies below the floor sees nothing, and its cone of rays has no weight there.
TEST(Bake, WhatLiesBelowTheFloorStaysFinite) {
  const Mesh sunk = make_box({-.5f, -1, -.5f}, {.5f, -.2f, .5f}, 4, kWhite);
  const Receiver floor{fit_ground_grid(sunk, 0, 16), kWhite};
  for (const BakeOptions& options : both_ways(settings(2, 3, 64, floor, 64))) {
    const BakedObject object = baked(sunk, options);
    for (const Transfer* t : {&object.transfer, &object.ground_deficit, &object.reflected})
      for (std::size_t p = 0; p < t->points; ++p)
        ASSERT_TRUE(std::isfinite(t->value(0, 0, p))) << p;
  }
}

// ------------------------------------------------------------------------------------- stability

TEST(Bake, IsBitIdenticalEveryTime) {
  const Mesh knot = make_knot(1, 60, 12, {.8f, .5f, .3f});
  const Receiver floor{fit_ground_grid(knot, 0, 32), {.5f, .5f, .5f}};
  const BakeOptions options = settings(3, 4, 64, floor, 64);
  const BakedObject a = baked(knot, options), b = baked(knot, options);
  EXPECT_EQ(a.transfer.values, b.transfer.values);
  EXPECT_EQ(a.ground_deficit.values, b.ground_deficit.values);
  EXPECT_EQ(a.report.standard_error, b.report.standard_error);
}

TEST(Bake, SizeAndPlaceLeaveTheTransferUnchanged) {
  const BakeOptions options = settings(4, 4, 256);
  const Transfer plain = baked(make_knot(1, 60, 12, {.7f, .7f, .7f}), options).transfer;
  struct AffineTransform {
    double scale, offset;
  };
  for (const AffineTransform placing : {AffineTransform{1e-3, 0}, {1e3, 0}, {1, 10}, {1e3, 1e4}}) {
    Mesh mesh = make_knot(1, 60, 12, {.7f, .7f, .7f});
    glm::dmat4 m = glm::translate(glm::dmat4(1), glm::dvec3(placing.offset));
    transform(mesh, glm::scale(m, glm::dvec3(placing.scale)));
    const Transfer moved = baked(mesh, options).transfer;
    ASSERT_EQ(moved.points, plain.points);
    double worst = 0, square = 0;
    for (std::size_t p = 0; p < plain.points; ++p)
      for (int n = 0; n < 16; ++n) {
        const double change = std::abs(moved.value(0, n, p) - plain.value(0, n, p));
        worst = std::max(worst, change);
        square += change * change / static_cast<double>(plain.points * 16);
      }
    EXPECT_LT(std::sqrt(square), 1e-4) << placing.scale << ' ' << placing.offset;
    // A ray that grazes an edge may fall on its other side once the positions are rounded.
    constexpr double kOneRay = .75 / 256;
    EXPECT_LT(worst, placing.offset > 0 ? kOneRay : 1e-3) << placing.scale << ' ' << placing.offset;
  }
}

// ------------------------------------------------------------------------------------- floors

// RMS difference of two transfers, coefficient by coefficient, over the RMS of the first.
double apart(const Transfer& a, const Transfer& b) {
  EXPECT_EQ(a.points, b.points);
  EXPECT_EQ(a.bands, b.bands);
  double difference = 0, all = 0;
  for (std::size_t p = 0; p < a.points; ++p)
    for (int n = 0; n < coefficient_count(a.bands); ++n)
      for (int c = 0; c < 3; ++c) {
        const double x = a.value(std::min(c, a.channels - 1), n, p),
                     y = b.value(std::min(c, b.channels - 1), n, p);
        difference += std::pow(x - y, 2), all += x * x;
      }
  return std::sqrt(difference / all);
}

// One bake serves floors of all albedos. The truth is a bake for each, with bounces to the end.
TEST(Bake, OneBakeStandsOnAnyFloor) {
  for (const Rgb own : {Rgb{.7f, .7f, .7f}, Rgb{.9f, .5f, .2f}}) {
    const Mesh knot = make_knot(.5f, 120, 24, own);
    const float below = bounds_of(knot).low.y;
    BakeOptions options = settings(5, 4, 256, Receiver{fit_ground_grid(knot, below, 32), kBlack});
    options.floor_apart = true;
    const BakedObject any = baked(knot, options);
    options.floor_apart = false;
    options.bounces = 40;
    for (const Rgb floor : {kBlack, Rgb{.15f, .15f, .15f}, Rgb{.4f, .4f, .4f}, Rgb{.8f, .6f, .3f},
                            Rgb{.95f, .95f, .95f}}) {
      options.receiver->albedo = floor;
      const BakedObject truth = baked(knot, options), ours = on_floor(any, floor);
      EXPECT_EQ(ours.receiver->albedo, floor);
      const double off = apart(truth.transfer, ours.transfer),
                   on_ground = apart(truth.ground_deficit, ours.ground_deficit),
                   without = apart(truth.transfer, any.transfer);
      std::printf(
          "object %.1f %.1f %.1f, floor %.2f %.2f %.2f: %.3f %% (without it %.1f), "
          "deficit %.3f %%\n",
          double(own.r), double(own.g), double(own.b), double(floor.r), double(floor.g),
          double(floor.b), 100 * off, 100 * without, 100 * on_ground);
      const bool bright = double(floor.r) > .5;
      EXPECT_LT(off, bright ? .015 : .002);
      EXPECT_LT(on_ground, bright ? .035 : .002);
      EXPECT_LT(apart(truth.reflected, ours.reflected), bright ? .03 : .01);
      EXPECT_LT(apart(truth.ground_reflected, ours.ground_reflected), bright ? .12 : .015);
      EXPECT_GT(without, .1 * double(floor.g)) << "the test must be able to fail";
    }
  }
}

TEST(Bake, CopiesShareTheirTransferUntilOneIsWritten) {
  const BakedObject one = baked(grey_knot(.5f), settings(3, 1, 64));
  BakedObject two = one;
  EXPECT_TRUE(two.transfer.values.shares(one.transfer.values));
  const float before = one.transfer.value(0, 0, 0);
  two.transfer.set(0, 0, 0, before + 1);
  EXPECT_FALSE(two.transfer.values.shares(one.transfer.values));
  EXPECT_EQ(one.transfer.value(0, 0, 0), before);
}

// ------------------------------------------------------------------------------------- errors

TEST(Bake, RefusesWhatItCannotBake) {
  const Mesh box = make_box({0, 0, 0}, {1, 1, 1}, 1, kWhite);
  const auto code = [](const Mesh& mesh, const BakeOptions& options) {
    const auto object = bake(mesh, options);
    return object ? std::nullopt : std::optional(object.error().code);
  };
  EXPECT_EQ(code({}, settings(3, 0, 64)), ErrorCode::kInvalid) << "no triangles";
  for (const int bands : {-1, 0, kMaxBands + 1})
    EXPECT_EQ(code(box, settings(bands, 0, 64)), ErrorCode::kInvalid) << bands;
  for (const int rays : {-64, 0, 1, 63, 65, 100}) {
    EXPECT_EQ(code(box, settings(3, 0, rays)), ErrorCode::kInvalid) << rays;
    EXPECT_EQ(code(box, settings(3, 0, 64, {}, rays)), ErrorCode::kInvalid) << rays;
  }
  EXPECT_EQ(code(box, settings(3, -1, 64)), ErrorCode::kInvalid);
  const std::vector<glm::mat3> frames(box.positions.size(), glm::mat3(1));
  BakeOptions turned = settings(3, 0, 64);
  turned.ray_frames = frames;
  EXPECT_EQ(code(box, turned), std::nullopt);
  turned.visibility = true;
  EXPECT_EQ(code(box, turned), ErrorCode::kInvalid) << "its rays have frames of their own";
  EXPECT_EQ(code(box, settings(kMaxBands, 0, 64)), std::nullopt);
}

// Not so in clips, where a texel whose number changes would flicker.
TEST(Bake, TexelsThatSeeLittleSendFewerRays) {
  const Mesh knot = make_knot(1, 60, 12, kWhite);
  constexpr int kTexels = 16 * 16, kRays = 1024;
  BakeOptions options = settings(1, 0, 64, Receiver{fit_ground_grid(knot, 0, 16), kBlack}, kRays);
  const std::uint64_t all = 64 * knot.positions.size() + std::uint64_t{kTexels} * kRays;
  const BakedObject few = baked(knot, options);
  EXPECT_LT(few.report.rays, all - kTexels * kRays / 3);
  std::vector<glm::mat3> frames;
  for (const glm::vec3& n : knot.normals) frames.push_back(frame_around(n));
  options.ray_frames = frames;
  const BakedObject many = baked(knot, options);
  EXPECT_EQ(many.report.rays, all);
  for (std::size_t p = 0; p < kTexels; ++p)
    EXPECT_NEAR(few.ground_deficit.value(0, 0, p), many.ground_deficit.value(0, 0, p), .002) << p;
}

TEST(BakeDeathTest, RefusesAnImpossibleReceiver) {
  // In processes of their own: the ray tracer aborts when it is asked about NaN.
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const Mesh box = make_box({0, 0, 0}, {1, 1, 1}, 1, kWhite);
  const GroundGrid good = fit_ground_grid(box, 0, 8);
  GroundGrid none = good, single = good, flat = good, nowhere = good, lost = good;
  none.size = 0, single.size = 1, flat.half_extent = 0;
  nowhere.height = NAN, lost.centre.x = INFINITY;
  for (const GroundGrid& grid : {none, single, flat, nowhere, lost})
    EXPECT_EXIT(
        {
          const auto object = bake(box, settings(2, 1, 64, Receiver{grid, kWhite}, 64));
          std::_Exit(object ? 1 : object.error().code == ErrorCode::kInvalid ? 0 : 2);
        },
        testing::ExitedWithCode(0), "")
        << grid.size << ' ' << grid.half_extent << ' ' << grid.height;
}

TEST(GroundGrid, PositionAndTextureCoordinateInvertEachOther) {
  GroundGrid grid = fit_ground_grid(make_sphere({3, 1, -2}, .5f, 2, kWhite), .5f, 32);
  EXPECT_EQ(grid.height, .5f);
  float last = -HUGE_VALF;
  for (float u = 0; u <= 1; u += 1 / 64.f) {
    const glm::vec2 p = grid.position({u, 1 - u});
    EXPECT_GT(p.x, last) << "positions rise with the coordinate";
    last = p.x;
    EXPECT_LT(glm::distance(grid.uv(p), glm::vec2(u, 1 - u)), 1e-5f);
  }
  EXPECT_LT(glm::distance(grid.position({.5f, .5f}), glm::vec2(3, -2)), 1e-5f);
  EXPECT_NEAR(grid.position({1, 1}).x, 3 + grid.half_extent, 1e-4);
  EXPECT_GT(grid.uv({3 + 1.01f * grid.half_extent, -2}).x, 1);
}

TEST(Bake, ProgressRisesToOne) {
  for (const int bounces : {0, 4})
    for (const bool visibility : {false, true}) {
      SCOPED_TRACE(testing::Message() << bounces << ' ' << visibility);
      double last = 0;
      BakeOptions options = settings(2, bounces, 64);
      options.visibility = visibility;
      options.progress = [&](double done) {
        EXPECT_GE(done, last);
        EXPECT_LE(done, 1);
        last = done;
      };
      baked(make_knot(1, 60, 12, kWhite), options);
      EXPECT_EQ(last, 1) << "or a bar's line does not end";
    }
}

TEST(Bake, StandardErrorFallsWithMoreRays) {
  double last = 1;
  for (const int rays : {64, 256, 1024}) {
    const double now = baked(grey_knot(0), settings(1, 0, rays)).report.standard_error;
    EXPECT_LT(now, .5 * last) << rays;
    EXPECT_GT(now, 0) << rays;
    last = now;
  }
}

TEST(Bake, ReportedStandardErrorIsTheTrueOne) {
  const Transfer truth = baked(grey_knot(0), settings(1, 0, 4096)).transfer;
  for (const int rays : {64, 256}) {
    const BakedObject object = baked(grey_knot(0), settings(1, 0, rays));
    double square = 0, mean = 0;
    for (std::size_t p = 0; p < truth.points; ++p) {
      square += std::pow(object.transfer.value(0, 0, p) - truth.value(0, 0, p), 2);
      mean += truth.value(0, 0, p);
    }
    const auto count = static_cast<double>(truth.points);
    const double error = std::sqrt(square / count) / (mean / count);
    EXPECT_GT(object.report.standard_error, error / 2) << rays;
    EXPECT_LT(object.report.standard_error, error * 2) << rays;
  }
}

}  // namespace
}  // namespace penumbra::prt
