#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/quaternion.hpp>
#include <limits>

#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"
#include "tests/support/lights.h"

namespace penumbra::shadows {
namespace {

using glm::dvec3;

constexpr Rgb kWhite{1, 1, 1}, kBlack{0, 0, 0}, kGrey{.5f, .5f, .5f};

prt::BakedObject baked(const prt::Mesh& mesh, int bands, int size = 64, int ground_rays = 1024) {
  prt::BakeOptions options;
  options.ground_rays = ground_rays;
  options.bands = bands;
  options.bounces = 1;
  options.rays = 64;
  options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, size), kBlack};
  auto object = prt::bake(mesh, options);
  EXPECT_TRUE(object);
  return object ? std::move(*object) : prt::BakedObject{};
}

PlanarShadow composed(const prt::BakedObject& object, const RadianceSh& light) {
  PlanarShadow shadow;
  EXPECT_TRUE(compose_planar_shadow(object, light, shadow));
  return shadow;
}

prt::Mesh knot(Rgb albedo = kBlack) {
  return prt::make_knot(1, 60, 12, albedo);
}

glm::dmat3 yaw(double angle) {
  return glm::mat3_cast(glm::angleAxis(angle, dvec3(0, 1, 0)));
}

RadianceSh turned(const RadianceSh& light, double angle) {
  return lighting::ShRotation(yaw(angle), light.bands()) * light;
}

glm::vec2 texel_position(const prt::GroundGrid& grid, int x, int y) {
  return grid.position((glm::vec2(x, y) + .5f) / static_cast<float>(grid.size));
}

void expect_all_one(const PlanarShadow& shadow) {
  ASSERT_FALSE(shadow.ratio.empty());
  for (const Rgb& s : shadow.ratio.pixels()) ASSERT_EQ(s, kWhite);
  EXPECT_TRUE(shadow.empty());
}

double largest_difference(const PlanarShadow& a, const PlanarShadow& b) {
  EXPECT_TRUE(a.ratio.same_size(b.ratio));
  double largest = 0;
  for (std::size_t i = 0; i < a.ratio.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double d = std::abs(double(a.ratio.pixels()[i][c]) - double(b.ratio.pixels()[i][c]));
      if (!(d <= largest)) largest = d;  // NaN is the largest of all
    }
  return largest;
}

// ------------------------------------------------------------------------------------- closed form

TEST(PlanarShadow, SphereUnderUniformSkyFollowsTheClosedForm) {
  for (const float height : {1.f, 1.5f, 3.f}) {  // of the centre, in radii: resting and hovering
    const auto object = baked(prt::make_sphere({0, height, 0}, 1, 4, kBlack), 3, 48, 4096);
    const PlanarShadow shadow = composed(object, test::constant_light({3, 1, .2f}, 3));
    const auto& grid = object.receiver->grid;
    int compared = 0;
    for (int y = 0; y < grid.size; ++y)
      for (int x = 0; x < grid.size; ++x) {
        const glm::vec2 p = texel_position(grid, x, y), uv = grid.uv(p);
        if (std::max(std::abs(2 * uv.x - 1), std::abs(2 * uv.y - 1)) > .9f)
          continue;  // the faded rim
        const double d = std::sqrt(double(p.x) * p.x + double(p.y) * p.y + double(height) * height);
        for (int c = 0; c < 3; ++c)
          ASSERT_NEAR(shadow.ratio.at(x, y)[c], 1 - height / (d * d * d), .01)
              << height << ' ' << p.x << ' ' << p.y;
        ++compared;
      }
    EXPECT_GT(compared, 1600);
  }
}

TEST(PlanarShadow, IsDeepestBelowARestingSphere) {
  const auto object = baked(prt::make_sphere({2, 1, -3}, 1, 4, kBlack), 1, 65);
  const PlanarShadow shadow = composed(object, test::constant_light(kWhite));
  EXPECT_NEAR(shadow.ratio.at(32, 32).g, 0, .01) << "no light reaches the point of contact";
  for (const Rgb& s : shadow.ratio.pixels()) ASSERT_TRUE(s.g >= 0 && s.g <= 1) << s.g;
}

TEST(PlanarShadow, ScaleOfTheLightDoesNotMatter) {
  const auto object = baked(knot(), 4);
  const RadianceSh light = test::random_light(4, 1, .1f);
  const PlanarShadow shadow = composed(object, light);
  for (const float scale : {1e-6f, 1e6f}) {
    RadianceSh scaled = light;
    for (Rgb& t : scaled.terms()) t = t * scale;
    EXPECT_LT(largest_difference(shadow, composed(object, scaled)), 1e-5) << scale;
  }
}

TEST(PlanarShadow, WhiteObjectGivesBackSomeOfTheLight) {
  const auto black = composed(baked(knot(kBlack), 2), test::constant_light(kWhite));
  const auto white = composed(baked(knot(kWhite), 2), test::constant_light(kWhite));
  double brighter = 0;
  for (std::size_t i = 0; i < black.ratio.area(); ++i) {
    ASSERT_GE(white.ratio.pixels()[i].g, black.ratio.pixels()[i].g - 1e-3f);
    ASSERT_LE(white.ratio.pixels()[i].g, 1.f);
    brighter += white.ratio.pixels()[i].g - black.ratio.pixels()[i].g;
  }
  EXPECT_GT(brighter, 0);
}

// ------------------------------------------------------------------------------------- yaw

TEST(PlanarShadow, YawOfAWholeTurnCloses) {
  const auto object = baked(knot(), 5);
  const RadianceSh light = test::random_light(5, 2, .15f);
  const PlanarShadow first = composed(object, light);
  RadianceSh going = light;
  double moved = 0;
  for (int i = 0; i < 24; ++i) {
    going = turned(going, 2 * kPi / 24);
    moved = std::max(moved, largest_difference(first, composed(object, going)));
  }
  EXPECT_GT(moved, .05) << "the light did turn";
  EXPECT_LT(largest_difference(first, composed(object, going)), 1e-3);
  EXPECT_LT(largest_difference(first, composed(object, turned(light, 2 * kPi))), 1e-3);
}

TEST(PlanarShadow, YawOfTheObjectIsTheOppositeYawOfTheLight) {
  // A quarter turn maps the grid onto itself: (x, z) goes to (z, -x), texel (x, y) to (y, size - 1
  // - x).
  const prt::Mesh mesh = knot();
  prt::Mesh rotated = mesh;
  prt::transform(rotated, glm::dmat4(yaw(kPi / 2)));
  const auto object = baked(mesh, 4), rotated_object = baked(rotated, 4);
  // The same place for both, since the bounds may differ in the last digit.
  ASSERT_NEAR(object.receiver->grid.half_extent, rotated_object.receiver->grid.half_extent, 1e-4);
  const RadianceSh light = test::random_light(4, 3, .15f);
  const PlanarShadow by_object = composed(rotated_object, light);
  const PlanarShadow by_light = composed(object, turned(light, -kPi / 2));
  double square = 0;
  const int size = by_light.ratio.width();
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const float s = by_light.ratio.at(x, y).g, t = by_object.ratio.at(y, size - 1 - x).g;
      ASSERT_NEAR(s, t, .02) << x << ' ' << y;
      square += std::pow(s - t, 2) / (double(size) * size);
    }
  EXPECT_LT(std::sqrt(square), .003) << "the noise of two bakes";
}

TEST(PlanarShadow, AnyYawOfTheObjectIsTheOppositeYawOfTheLight) {
  constexpr double kAngle = .65;
  constexpr int kSize = 96;
  const prt::Mesh mesh = knot();
  prt::Mesh rotated = mesh;
  prt::transform(rotated, glm::dmat4(yaw(kAngle)));
  const auto object = baked(mesh, 4, kSize), rotated_object = baked(rotated, 4, kSize);
  const RadianceSh light = test::random_light(4, 4, .15f);
  const PlanarShadow by_object = composed(rotated_object, light);
  const PlanarShadow by_light = composed(object, turned(light, -kAngle));
  const auto& grid = object.receiver->grid;
  double square = 0;
  int compared = 0;
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const glm::vec2 p = texel_position(rotated_object.receiver->grid, x, y);
      if (glm::length(p) > .5f * grid.half_extent) continue;
      const dvec3 before = yaw(-kAngle) * dvec3(p.x, 0, p.y);
      const glm::vec2 at = grid.uv({before.x, before.z}) * float(kSize) - .5f;
      const int x0 = int(at.x), y0 = int(at.y);
      const float fx = at.x - float(x0), fy = at.y - float(y0);
      const auto s = [&](int i, int j) { return by_light.ratio.at(x0 + i, y0 + j).g; };
      const float there =
          (1 - fy) * ((1 - fx) * s(0, 0) + fx * s(1, 0)) + fy * ((1 - fx) * s(0, 1) + fx * s(1, 1));
      square += std::pow(by_object.ratio.at(x, y).g - there, 2);
      ++compared;
    }
  ASSERT_GT(compared, 1000);
  EXPECT_LT(std::sqrt(square / compared), .01);
}

// ------------------------------------------------------------------------------------- rectangle

TEST(PlanarShadow, IsExactlyOneOutsideItsRectangleWhichIsTight) {
  const auto object = baked(prt::make_sphere({0, 1.4f, 0}, 1, 3, kBlack), 3);
  for (const RadianceSh& light :
       {test::constant_light(kWhite, 3), test::sloped_light(1, {.6, .5, 0}, 3)}) {
    const PlanarShadow shadow = composed(object, light);
    ASSERT_FALSE(shadow.empty());
    int left = 64, top = 64, right = 0, bottom = 0;
    for (int y = 0; y < 64; ++y)
      for (int x = 0; x < 64; ++x) {
        if (shadow.ratio.at(x, y) == kWhite) continue;
        left = std::min(left, x), right = std::max(right, x + 1);
        top = std::min(top, y), bottom = std::max(bottom, y + 1);
      }
    EXPECT_EQ(shadow.x0, left);
    EXPECT_EQ(shadow.x1, right);
    EXPECT_EQ(shadow.y0, top);
    EXPECT_EQ(shadow.y1, bottom);
  }
}

TEST(PlanarShadow, FadesToOneAtTheRim) {
  const auto object = baked(prt::make_sphere({0, 3, 0}, 1, 3, kBlack), 1);
  const PlanarShadow shadow = composed(object, test::constant_light(kWhite));
  for (int i = 0; i < 64; ++i)
    for (const Rgb& s : {shadow.ratio.at(i, 0), shadow.ratio.at(i, 63), shadow.ratio.at(0, i),
                         shadow.ratio.at(63, i)})
      EXPECT_EQ(s, kWhite);
}

TEST(PlanarShadow, OldShadowDoesNotShowThroughTheNext) {
  const auto object = baked(knot(), 3);
  PlanarShadow shadow = composed(object, test::constant_light(kWhite, 3));
  ASSERT_FALSE(shadow.empty());
  ASSERT_TRUE(compose_planar_shadow(object, RadianceSh(3), shadow));
  expect_all_one(shadow);
  const auto larger = baked(knot(), 3, 80);
  ASSERT_TRUE(compose_planar_shadow(larger, test::constant_light(kWhite, 3), shadow));
  EXPECT_EQ(largest_difference(shadow, composed(larger, test::constant_light(kWhite, 3))), 0);
}

// ------------------------------------------------------------------------------------- no light

TEST(PlanarShadow, WithoutLightThereIsNone) {
  for (const int bands : {1, 3, 5}) {
    const auto object = baked(knot(), bands, 16);
    expect_all_one(composed(object, RadianceSh(bands)));
    expect_all_one(composed(object, RadianceSh(9)));
  }
}

TEST(PlanarShadow, LightFromBelowOnlyCastsNone) {
  Image<Rgb> map(128, 64);
  for (int y = 32; y < 64; ++y)
    for (Rgb& p : map.row(y)) p = {4, 2, 1};
  const auto below = lighting::project_latlong(map, 5);
  ASSERT_TRUE(below);
  for (const int bands : {2, 3, 5}) {
    const auto object = baked(knot(), bands, 16);
    expect_all_one(composed(object, below->light));
    // A linear light that leaves a surface facing up exactly dark.
    expect_all_one(composed(object, test::sloped_light(1, {0, -1.5, 0})));
  }
}

TEST(PlanarShadow, ColourWithoutLightStaysUntouched) {
  const auto object = baked(knot(), 2);
  const PlanarShadow shadow = composed(object, test::constant_light({1, 0, 1e-30f}, 2));
  ASSERT_FALSE(shadow.empty());
  float deepest = 1;
  for (const Rgb& s : shadow.ratio.pixels()) {
    ASSERT_EQ(s.g, 1);
    ASSERT_TRUE(is_finite(s));
    deepest = std::min(deepest, s.r);
  }
  EXPECT_LT(deepest, .5f);
}

TEST(PlanarShadow, StaysInItsRangeUnderAnyLight) {
  const auto object = baked(knot(kGrey), 5, 48);
  for (unsigned seed = 0; seed < 30; ++seed) {
    const PlanarShadow shadow =
        composed(object, test::random_light(5, seed, 2));  // negative lobes and all
    for (const Rgb& s : shadow.ratio.pixels())
      for (int c = 0; c < 3; ++c) ASSERT_TRUE(s[c] >= 0 && s[c] <= 1.5f) << s[c];
  }
}

TEST(PlanarShadow, NonFiniteLightNeverReachesThePicture) {
  const auto object = baked(knot(), 2, 16);
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()})
    for (const int n : {0, 1, 3}) {
      RadianceSh light = test::constant_light(kWhite, 2);
      light[n].r = bad;
      PlanarShadow shadow;
      if (!compose_planar_shadow(object, light, shadow)) continue;  // an error is as good
      for (const Rgb& s : shadow.ratio.pixels()) ASSERT_TRUE(is_finite(s)) << bad << ' ' << n;
    }
}

TEST(PlanarShadow, ObjectWithoutReceiverIsAnError) {
  const auto object = prt::bake(prt::make_box({0, 0, 0}, {1, 1, 1}, 1, kWhite), {});
  ASSERT_TRUE(object);
  PlanarShadow shadow;
  const auto done = compose_planar_shadow(*object, test::constant_light(kWhite), shadow);
  ASSERT_FALSE(done);
  EXPECT_EQ(done.error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::shadows
