// What the floor around an object sees of the object, of a wall behind it and of a wall in view.
#include "runtime/surroundings/ground_probes.h"

#include <gtest/gtest.h>

#include <cmath>

#include "prt/prt.h"
#include "runtime/surroundings/plane_light.h"
#include "tests/support/ball_and_wall.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;

// A ball of 20 cm on the floor, a large wall 50 cm behind it, at z = -1/2 m.
class BallOnTheFloor : public testing::Test, public test::BallAndWall {
 protected:
  BallOnTheFloor()
      : BallAndWall({{{-9, 0, -.5f}, {-9, 9, -.5f}, {9, 9, -.5f}, {9, 0, -.5f}}}, {0, 0, 1}, {}) {}
  glm::vec2 place_of(int point) const {
    constexpr int n = GroundProbes::kSize;
    return scene.objects[0].baked.receiver->grid.position(
        {(float(point % n) + .5f) / n, (float(point / n) + .5f) / n});
  }
};

TEST_F(BallOnTheFloor, BeforeItTheWallIsBehindItAndBehindItTheSky) {
  GroundProbes probes(scene);
  const Pose here;
  probes.update(occluders(), {&here, 1}, false);
  std::array<int, GroundProbes::kPoints> by_ball{}, wall_behind{}, wall{};
  int behind_wall = 0;  // rays that the wall stops before the ball does
  for (const GroundHit& hit : probes.hits(0)) {
    by_ball[hit.point] += hit.object_first;
    wall_behind[hit.point] += hit.object_first && hit.real;
    wall[hit.point] += !hit.object_first;
    behind_wall += hit.bake_blocks && !hit.object_first;
  }
  int before = 0, behind = 0, points = 0;
  double square = 0;
  for (int p = 0; p < GroundProbes::kPoints; ++p) {
    const glm::vec2 at = place_of(p);
    const auto i = static_cast<std::size_t>(p);
    if (at.y < -.5f) continue;  // within or behind the wall
    const double d2 = double(at.x) * double(at.x) + double(at.y) * double(at.y);
    if (d2 < .3 * .3) continue;
    // Form factor (R/d)^2 cos of a ball that stands on the floor: wholly above it.
    const double to = d2 + .04, factor = .04 / to * .2 / std::sqrt(to);
    const double off = by_ball[i] / double(GroundProbes::kRays) - factor;
    EXPECT_NEAR(off, 0, .06) << at.x << ' ' << at.y;
    square += off * off;
    ++points;
    if (at.y > .35f && std::abs(at.x) < .1f) before += wall_behind[i];
    if (at.y < -.3f && std::abs(at.x) < .1f) behind += wall_behind[i];
    if (at.y > -.45f && at.y < .2f && std::abs(at.x) > .5f) {
      EXPECT_GT(wall[i], 0);
    }
  }
  ASSERT_GT(points, 100);
  EXPECT_LT(std::sqrt(square / points), .015);
  EXPECT_GT(before, 0);
  EXPECT_GT(behind_wall, 0) << "the bake counts on these, the ball does not take them";
  EXPECT_EQ(behind, 0) << "from between wall and ball the sky is behind the ball";
}

TEST_F(BallOnTheFloor, WhatAllPointsHaveAllTexelsGetAndASlopeStaysASlope) {
  constexpr int kTexels = 64, n = GroundProbes::kSize;
  scene.real_mesh = prt::make_box({50, 0, 50}, {51, 1, 51}, 1, {.5f, .5f, .5f});
  real_things->set_pose(0, Pose{{1, 0, 0, 0}, {0, 0, -90}});  // the wall is far
  GroundProbes probes(scene);
  const Pose here;
  probes.update(occluders(), {&here, 1}, false);
  std::array<Rgb, GroundProbes::kPoints> values;
  for (int p = 0; p < GroundProbes::kPoints; ++p)
    values[static_cast<std::size_t>(p)] = {1, float(p % n), float(p / n)};
  std::vector<float> out(3 * kTexels * kTexels, 2.f);
  probes.spread(0, values, kTexels, out);
  for (int y = 2; y < kTexels - 2; ++y)
    for (int x = 2; x < kTexels - 2; ++x) {
      const auto i = static_cast<std::size_t>(y * kTexels + x);
      ASSERT_NEAR(out[i], 3, 1e-5);
      ASSERT_NEAR(out[kTexels * kTexels + i], 2 + (x + .5) * n / kTexels - .5, 1e-4);
      ASSERT_NEAR(out[2 * kTexels * kTexels + i], 2 + (y + .5) * n / kTexels - .5, 1e-4);
    }
}

TEST(GroundProbes, WithoutRealThingsThereIsNothingToLookAt) {
  PreparedScene scene;
  scene.objects.emplace_back().baked.mesh = prt::make_sphere({0, .2f, 0}, .2f, 2, {1, 1, 1});
  EXPECT_FALSE(GroundProbes(scene).any());
}

// Half of the residual is left by a real thing, an object takes .2 of the open light there, a light
// of fraction .3 is hidden by a real thing on one side and by the object on the other.
TEST(PlaneLight, IsWhatTheCompositorShows) {
  const prt::Plane plane{{0, 0, 0}, {0, 1, 0}, {.5f, .5f, .5f}, {}};
  const Rgb open{static_cast<float>(2 * kPi), static_cast<float>(2 * kPi),
                 static_cast<float>(2 * kPi)};
  prt::GroundGrid grid;
  grid.size = 8;
  const auto even = [](float ratio) {
    shadows::PlanarShadow s;
    s.ratio = Image<Rgb>(8, 8);
    std::ranges::fill(s.ratio.pixels(), Rgb{ratio, ratio, ratio});
    s.x1 = s.y1 = 8;
    return s;
  };
  const shadows::PlanarShadow by_real = even(.5f), by_object = even(.8f);
  const auto half_plane = [](float left, float right) {
    shadows::ShadowMap map;
    map.world_from_map = Pose{{1, 0, 0, 0}, {-1, 0, -1}};
    map.cell_m = .1f;
    map.virtual_occlusion = Image<float>(21, 21);
    for (int y = 0; y < 21; ++y)
      for (int x = 0; x < 21; ++x) map.virtual_occlusion.at(x, y) = x < 10 ? left : right;
    return map;
  };
  const shadows::ShadowMap taken = half_plane(0, 1), hidden = half_plane(1, 0);
  const compositor::ShadowMapOnPlane light{&taken, {.3f, .3f, .3f}, &hidden};
  const PlaneLight on(std::span(&plane, 1), std::span(&open, 1), std::span(&light, 1),
                      {{&by_real, &grid, {}, true}, {&by_object, &grid, {}, false}});
  // The open plane's radiance is .5 2 pi/pi = 1.
  const PlaneLight::Radiance left = on.at(0, {-.55f, 0, .02f}), right = on.at(0, {.55f, 0, .02f}),
                             above = on.at(0, {.55f, .5f, .02f});
  EXPECT_NEAR(left.before.g, .5 - .3, 1e-5);
  EXPECT_NEAR(left.now.g, 0, 1e-5) << "no more is taken than there is";
  EXPECT_NEAR(right.before.g, .5, 1e-5);
  EXPECT_NEAR(right.now.g, .5 - .2 - .3, 1e-5);
  EXPECT_NEAR(above.before.g, 1, 1e-5) << "not on the plane";
}

}  // namespace
}  // namespace penumbra::runtime
