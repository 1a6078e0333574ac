#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <random>
#include <string>
#include <vector>

#include "calib/calib.h"
#include "core/conventions.h"
#include "tests/support/ball_pictures.h"

namespace penumbra::calib {
namespace {

using glm::dvec3;

dvec3 random_direction(std::mt19937& rng) {
  std::normal_distribution<double> g;
  return glm::normalize(dvec3(g(rng), g(rng), g(rng)));
}

// The point where the ray meets the ball lies on both, and the mirrored ray has the same angle to
// the normal there.
TEST(MirrorBall, RayAndLightObeyTheLawOfReflectionAtAnyDistance) {
  std::mt19937 rng(1);
  for (const double distance : {1.05, 1.5, 4., 50.}) {
    const dvec3 centre = distance * random_direction(rng);
    const auto ball = MirrorBall::at(centre, 1);
    ASSERT_TRUE(ball);
    int seen = 0;
    for (int i = 0; i < 2000; ++i) {
      const dvec3 light = random_direction(rng);
      const auto ray = ball->ray_from_light(light);
      const bool behind = glm::dot(light, centre) / distance > std::cos(std::asin(1 / distance));
      ASSERT_EQ(ray.has_value(), !behind) << distance;
      if (!ray) continue;
      ++seen;
      const double along = glm::dot(ray->ray, centre);
      const double depth = along - std::sqrt(std::max(0., along * along - distance * distance + 1));
      const dvec3 normal = depth * ray->ray - centre;
      ASSERT_NEAR(glm::length(normal), 1, 1e-6);
      EXPECT_NEAR(glm::length(glm::normalize(light - ray->ray) - normal), 0, 2e-5) << distance;
      ASSERT_TRUE(ray->from_rim >= 0 && ray->from_rim <= 1);
      if (ray->from_rim < 1e-4) continue;
      const auto back = test::reflected(*ball, 2. * ray->ray);
      ASSERT_TRUE(back);
      EXPECT_NEAR(glm::length(*back - light), 0, 1e-7);
    }
    EXPECT_GT(seen, 1000);
  }
}

TEST(MirrorBall, FarAwayItIsTheOrthographicBallOfTheTextbook) {
  const auto ball = MirrorBall::at({0, 0, -1e5}, 1);
  ASSERT_TRUE(ball);
  const double angle = 1.1;  // from the direction back to the camera
  const auto seen = ball->ray_from_light({std::sin(angle), 0, std::cos(angle)});
  ASSERT_TRUE(seen);
  EXPECT_NEAR(seen->ray.x * 1e5, std::sin(angle / 2), 1e-4);
}

TEST(MirrorBall, OutlineInThePictureGivesItsDirectionAndSize) {
  auto camera = *make_projection(ProjectionKind::kPinhole, 1280, 720);
  const dvec3 centre(.3, -.2, -1.4);
  const auto truth = MirrorBall::at(centre, .1);
  // The outline's ellipse, and the circle that someone would lay over it: its middle and half its
  // longer axis.
  const dvec3 axis = truth->direction();
  const dvec3 radial = glm::normalize(dvec3(axis.x, axis.y, 0));
  const dvec3 out = glm::normalize(radial - glm::dot(radial, axis) * axis);
  const double a = truth->angular_radius_rad();
  const auto near = *pixel_from_direction(camera, axis * std::cos(a) - out * std::sin(a));
  const auto far = *pixel_from_direction(camera, axis * std::cos(a) + out * std::sin(a));
  const auto found =
      MirrorBall::from_outline(camera, (near + far) / 2., glm::length(far - near) / 2);
  ASSERT_TRUE(found);
  EXPECT_NEAR(glm::length(found->direction() - axis), 0, 1e-9);
  EXPECT_NEAR(found->angular_radius_rad(), a, 1e-9);
}

// Outlines from the truth, with noise of half a pixel in centre and radius.
std::vector<BallOutline> outlines_of(const dvec3& centre_m, double radius_m, int cameras,
                                     std::mt19937& rng, double sigma_px) {
  std::normal_distribution<double> noise(0, sigma_px);
  std::vector<BallOutline> out;
  for (int i = 0; i < cameras; ++i) {
    BallOutline o;
    o.camera = "camera " + std::to_string(i);
    o.projection = *make_projection(ProjectionKind::kPinhole, 1280, 720);
    o.world_from_camera = {glm::angleAxis(.3 * i, dvec3(0, 1, 0)), dvec3(.6 * i, .1, .05 * i)};
    const auto ball = *MirrorBall::at(o.world_from_camera.inverse() * centre_m, radius_m);
    const dvec3 axis = ball.direction(),
                radial = glm::normalize(dvec3(axis.x, axis.y, 0) + dvec3(1e-9, 0, 0)),
                across = glm::normalize(radial - glm::dot(radial, axis) * axis);
    const double a = ball.angular_radius_rad();
    const auto near =
                   *pixel_from_direction(o.projection, axis * std::cos(a) - across * std::sin(a)),
               far = *pixel_from_direction(o.projection, axis * std::cos(a) + across * std::sin(a));
    o.centre_px = (near + far) / 2. + glm::dvec2(noise(rng), noise(rng));
    o.radius_px = glm::length(far - near) / 2 + noise(rng);
    out.push_back(o);
  }
  return out;
}

TEST(MirrorBall, ItsPlaceFollowsFromItsOutlinesWithAnHonestUncertainty) {
  std::mt19937 rng(4);
  const dvec3 truth(.25, -.1, -1.3);
  for (const int cameras : {1, 2}) {
    int covered = 0, all = 0;
    for (int run = 0; run < 200; ++run) {
      const auto place = locate_ball(outlines_of(truth, .06, cameras, rng, .5), .06, .5);
      ASSERT_TRUE(place) << place.error().detail;
      for (int k = 0; k < 3; ++k, ++all) {
        covered += std::abs(place->centre_m[k] - truth[k]) < 1.96 * place->sigma_m[k];
        EXPECT_NEAR(place->centre_m[k], truth[k], cameras == 1 ? .1 : .02);
      }
    }
    EXPECT_GE(covered, .92 * all) << cameras;
    EXPECT_LE(covered, .985 * all) << cameras;
  }
}

TEST(MirrorBall, OutlinesThatContradictEachOtherAreRefusedByName) {
  std::mt19937 rng(5);
  auto outlines = outlines_of({.25, -.1, -1.3}, .06, 2, rng, 0);
  EXPECT_TRUE(locate_ball(outlines, .06));
  EXPECT_FALSE(locate_ball(outlines, .09)) << "another radius";
  outlines[1].centre_px.x += 40;
  const auto refused = locate_ball(outlines, .06);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUndetermined);
  EXPECT_NE(refused.error().where.find("camera"), std::string::npos);
  EXPECT_FALSE(locate_ball({}, .06));
}

TEST(MirrorBall, WhatIsNoBallIsRefused) {
  EXPECT_FALSE(MirrorBall::at({0, 0, -1}, 1.5));
  EXPECT_FALSE(MirrorBall::at({0, 0, -1}, 0));
  EXPECT_FALSE(MirrorBall::at({0, NAN, -1}, .1));
  const auto camera = *make_projection(ProjectionKind::kPinhole, 64, 64);
  EXPECT_FALSE(MirrorBall::from_outline(camera, {60, 30}, 10));
  EXPECT_FALSE(MirrorBall::from_outline(camera, {30, 30}, -3));
}

}  // namespace
}  // namespace penumbra::calib
