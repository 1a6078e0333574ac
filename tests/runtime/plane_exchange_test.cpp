// Planes that light each other, against what two half hemispheres come to in closed form.
#include "runtime/surroundings/plane_exchange.h"

#include <gtest/gtest.h>

#include <array>

#include "core/conventions.h"

namespace penumbra::runtime {
namespace {

constexpr float kFloorAlbedo = .4f, kWallAlbedo = .6f;

std::vector<prt::Plane> floor_and_wall(double distance_m) {
  return {{{0, 0, 0}, {0, 1, 0}, {kFloorAlbedo, kFloorAlbedo, kFloorAlbedo}, {}},
          {{0, 0, -distance_m}, {0, 0, 1}, {kWallAlbedo, kWallAlbedo, kWallAlbedo}, {}}};
}

RadianceSh even_light() {
  RadianceSh out(5);
  out[0] = Rgb{1, 1, 1} * static_cast<float>(std::sqrt(4 * kPi));
  return out;
}

// What planes see of each other by the cosine is (1 - n.n')/2, from whatever distance and also
// where the wall leans back and the floor before it is all that it sees.
TEST(PlaneExchange, AFloorBeforeAWallHasHalfOfTheSky) {
  const RadianceSh light = even_light();
  const std::array<const RadianceSh*, 2> residuals{&light, &light};
  for (const double distance_m : {.3, 30.})
    for (const double lean_deg : {-20., -1., 0., 1., 20., 60.}) {
      std::vector<prt::Plane> planes = floor_and_wall(distance_m);
      const double lean = lean_deg * kPi / 180;
      planes[1].normal = {0, std::sin(lean), std::cos(lean)};
      const double seen = (1 - planes[1].normal.y) / 2;
      // f = a_f (1 - seen + seen w) and w = a_w (1 - seen + seen f)
      const double f = kFloorAlbedo * (1 - seen) * (1 + seen * kWallAlbedo) /
                       (1 - seen * seen * kFloorAlbedo * kWallAlbedo),
                   w = kWallAlbedo * (1 - seen + seen * f);
      const PlaneExchange exchange(planes, {0, 0, 0});
      ASSERT_TRUE(exchange.any());
      std::array<Rgb, 2> changes;
      exchange.changes(residuals, {}, changes);
      EXPECT_NEAR(changes[0].g, kPi * seen * (w - 1), .02) << distance_m << " " << lean_deg;
      EXPECT_NEAR(changes[1].g, kPi * seen * (f - 1), .02) << distance_m << " " << lean_deg;
    }
}

// Walls all around, a ceiling: no light comes in.
TEST(PlaneExchange, AClosedRoomIsDark) {
  const RadianceSh light = even_light();
  const std::vector<const RadianceSh*> residuals(6, &light);
  std::vector<prt::Plane> planes;
  for (int axis = 0; axis < 3; ++axis)
    for (const double side : {-1., 1.}) {
      prt::Plane wall;
      wall.point = wall.normal = glm::dvec3(0);
      wall.point[axis] = 2 * side, wall.normal[axis] = -side;
      wall.albedo = {.7f, .7f, .7f};
      planes.push_back(wall);
    }
  std::vector<Rgb> changes(6);
  PlaneExchange(planes, {0, -2, 0}).changes(residuals, {}, changes);
  for (const Rgb& change : changes) EXPECT_NEAR(change.g, -kPi, .02);
}

// Nobody knows what it sends, and the map may show it.
TEST(PlaneExchange, AWallOfUnknownAlbedoHidesNothing) {
  std::vector<prt::Plane> planes = floor_and_wall(.5);
  planes[1].albedo = {};
  const RadianceSh light = even_light();
  const std::array<const RadianceSh*, 2> residuals{&light, &light};
  std::array<Rgb, 2> changes;
  PlaneExchange(planes, {0, 0, 0}).changes(residuals, {}, changes);
  EXPECT_EQ(changes[0].g, 0);
}

// What the wall sends of a sun before it reaches the floor; a sun behind it lights neither.
TEST(PlaneExchange, ASunCountsWhereItShines) {
  const RadianceSh dark(5);
  const std::array<const RadianceSh*, 2> residuals{&dark, &dark};
  const std::vector<prt::Plane> planes = floor_and_wall(.5);
  const PlaneExchange exchange(planes, {0, 0, 0});
  lighting::DistantLight sun;
  sun.radius = Radians(.005);
  sun.radiance = {1e4f, 1e4f, 1e4f};
  std::array<Rgb, 2> changes;
  sun.direction = glm::normalize(glm::dvec3(0, 1, 2));
  exchange.changes(residuals, {&sun, 1}, changes);
  const double on_floor = lighting::irradiance(sun, {0, 1, 0}).g,
               on_wall = lighting::irradiance(sun, {0, 0, 1}).g;
  const double f = kFloorAlbedo * (on_floor + kWallAlbedo * on_wall / 2) /
                   (1 - kFloorAlbedo * kWallAlbedo / 4.),
               w = kWallAlbedo * (on_wall + f / 2);
  EXPECT_NEAR(changes[0].g / (w / 2), 1, .01);
  EXPECT_NEAR(changes[1].g / (f / 2), 1, .01);
  // A window that the wall's edge divides counts by half.
  sun.direction = {0, 1, 0};
  for (int i = 0; i < lighting::DistantLight::kShapePoints; ++i)
    sun.shape.push_back(glm::normalize(glm::dvec3(0, 2, i % 2 ? .5 : -.5)));
  exchange.changes(residuals, {&sun, 1}, changes);
  const double half = kFloorAlbedo * lighting::irradiance(sun, {0, 1, 0}).g / 2;
  EXPECT_GT(changes[1].g, .45 * half);
  sun.shape.clear();
  sun.direction = glm::normalize(glm::dvec3(0, 1, -2));
  exchange.changes(residuals, {&sun, 1}, changes);
  EXPECT_EQ(changes[0].g, 0);
  EXPECT_EQ(changes[1].g, 0);
}

TEST(PlaneExchange, APlaneAloneLosesNothing) {
  const std::vector<prt::Plane> planes(1);
  EXPECT_FALSE(PlaneExchange(planes, {0, 0, 0}).any());
  // A second one below it, that faces the same way, is seen by nobody either.
  const std::vector<prt::Plane> stacked{{}, {{0, -1, 0}, {0, 1, 0}, {}, {}}};
  EXPECT_FALSE(PlaneExchange(stacked, {0, 0, 0}).any());
}

}  // namespace
}  // namespace penumbra::runtime
