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

// Each fills half of the other's hemisphere, from whatever distance.
TEST(PlaneExchange, AFloorBeforeAWallHasHalfOfTheSky) {
  const RadianceSh light = even_light();
  const std::array<const RadianceSh*, 2> residuals{&light, &light};
  // f = a_f (1 + w)/2 and w = a_w (1 + f)/2
  const double f = kFloorAlbedo * (1 + kWallAlbedo / 2.) / 2 /
                   (1 - kFloorAlbedo * kWallAlbedo / 4.),
               w = kWallAlbedo * (1 + f) / 2;
  for (const double distance_m : {.3, 30.}) {
    const std::vector<prt::Plane> planes = floor_and_wall(distance_m);
    const PlaneExchange exchange(planes, {0, 0, 0});
    ASSERT_TRUE(exchange.any());
    std::array<Rgb, 2> changes;
    exchange.changes(residuals, {}, changes);
    EXPECT_NEAR(changes[0].g, kPi * (w - 1) / 2, .01) << distance_m;
    EXPECT_NEAR(changes[1].g, kPi * (f - 1) / 2, .01) << distance_m;
  }
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
  sun.direction = glm::normalize(glm::dvec3(0, 1, -2));
  exchange.changes(residuals, {&sun, 1}, changes);
  EXPECT_EQ(changes[0].g, 0);
  EXPECT_EQ(changes[1].g, 0);
}

TEST(PlaneExchange, APlaneAloneLosesNothing) {
  const std::vector<prt::Plane> planes{{}};
  EXPECT_FALSE(PlaneExchange(planes, {0, 0, 0}).any());
  // A second one below it, that faces the same way, is seen by nobody either.
  const std::vector<prt::Plane> stacked{{}, {{0, -1, 0}, {0, 1, 0}, {}, {}}};
  EXPECT_FALSE(PlaneExchange(stacked, {0, 0, 0}).any());
}

}  // namespace
}  // namespace penumbra::runtime
