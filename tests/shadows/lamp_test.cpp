#include "prt/prt.h"

#include <gtest/gtest.h>

#include <cmath>

#include "shadows/shadows.h"

namespace penumbra::shadows {
namespace {

struct LampWorld {
  prt::RayWorld rays = *prt::RayWorld::create();
  RayOccluders occluders() const { return {&rays, nullptr, 1e-4f}; }
};

const prt::Plane kFloor;

TEST(Lamp, OpenFloorFollowsTheClosedForm) {
  const LampWorld world;
  const Lamp lamp{{.3, .8, -.2}, .01, {1, 1, 1}};
  ShadowMap map;
  const float largest = trace_lamp_map(world.occluders(), kFloor, lamp, 8, map);
  EXPECT_NEAR(largest, 1 / (.8 * .8), 1e-3);
  for (const glm::dvec3 p : {glm::dvec3(.3, 0, -.2), {.8, 0, .1}, {-1, 0, .5}, {1.5, 0, -1.5}}) {
    const glm::dvec3 at = map.world_from_map.inverse() * p / double(map.cell_m);
    const int x = static_cast<int>(std::lround(at.x)), z = static_cast<int>(std::lround(at.z));
    const glm::dvec3 node =
        map.world_from_map * glm::dvec3(x * double(map.cell_m), 0, z * double(map.cell_m));
    const double d2 = glm::dot(lamp.position - node, lamp.position - node);
    EXPECT_NEAR(map.virtual_occlusion.at(x, z) * largest, .8 / std::pow(d2, 1.5), 2e-3 / (.8 * .8));
  }
  for (int i = 0; i < map.virtual_occlusion.width(); ++i)
    EXPECT_EQ(map.virtual_occlusion.at(i, 0), 0) << "ends at nothing";
}

TEST(Lamp, BehindTheFloorOrInItGivesNothing) {
  const LampWorld world;
  ShadowMap map;
  for (const double height : {-.5, 0., .01}) {
    EXPECT_EQ(trace_lamp_map(world.occluders(), kFloor, {{0, height, 0}, .02, {1, 1, 1}}, 8, map),
              0);
    EXPECT_TRUE(map.empty());
  }
}

TEST(Lamp, PenumbraFollowsSimilarTriangles) {
  // A half plane at height h below a lamp of radius r at height H: the penumbra is 2 r h/(H - h)
  // wide.
  LampWorld world;
  constexpr double kLamp = 1, kEdge = .4, kRadius = .1;
  prt::Mesh half;
  half.positions = {{0, kEdge, -9}, {0, kEdge, 9}, {9, kEdge, 9}, {9, kEdge, -9}};
  half.normals.assign(4, {0, 1, 0});
  half.albedo.assign(4, {.5f, .5f, .5f});
  half.triangles = {{0, 1, 2}, {0, 2, 3}};
  (void)*world.rays.add(half);
  const Lamp lamp{{0, kLamp, 0}, kRadius, {1, 1, 1}};
  std::vector<glm::vec3> points, normals;
  for (int i = -400; i <= 400; ++i) points.emplace_back(i * 5e-4f, 0, 0);
  normals.assign(points.size(), {0, 1, 0});
  std::vector<float> open(points.size()), seen(points.size());
  trace_lamp_points(LampWorld().occluders(), points, normals, lamp, 64, open);
  trace_lamp_points(world.occluders(), points, normals, lamp, 64, seen);
  double first = 1, last = -1;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const float fraction = seen[i] / open[i];
    if (fraction < .98f && fraction > .02f)
      first = std::min(first, double(points[i].x)), last = std::max(last, double(points[i].x));
  }
  const double width = 2 * kRadius * kEdge / (kLamp - kEdge);
  // The rim of a round lamp weighs little: 2 % of its area lies beyond .9 of its radius.
  EXPECT_NEAR(last - first, .93 * width, .08 * width);
}

TEST(Lamp, BlockersBeyondTheLampDoNotCount) {
  LampWorld world;
  prt::Mesh lid = prt::make_box({-5, 2, -5}, {5, 2.1f, 5}, 1, {.5f, .5f, .5f});
  (void)*world.rays.add(lid);
  const std::vector<glm::vec3> point{{0, 0, 0}}, normal{{0, 1, 0}};
  float below = 0, above = 0;
  trace_lamp_points(world.occluders(), point, normal, {{0, 1, 0}, .05, {1, 1, 1}}, 16, {&below, 1});
  trace_lamp_points(world.occluders(), point, normal, {{0, 3, 0}, .05, {1, 1, 1}}, 16, {&above, 1});
  EXPECT_NEAR(below, 1, .01);
  EXPECT_EQ(above, 0);
}

TEST(Lamp, PointInsideTheLampStaysFinite) {
  const LampWorld world;
  const std::vector<glm::vec3> point{{0, 1, 0}}, normal{{0, 1, 0}};
  float value = 0;
  trace_lamp_points(world.occluders(), point, normal, {{0, 1, 0}, 0, {1, 1, 1}}, 4, {&value, 1});
  EXPECT_TRUE(std::isfinite(value));
  trace_lamp_points(world.occluders(), point, normal, {{0, 1.001, 0}, .05, {1, 1, 1}}, 4,
                    {&value, 1});
  EXPECT_TRUE(std::isfinite(value));
  EXPECT_LE(value, 1 / (.05f * .05f) * 1.01f);
}

}  // namespace
}  // namespace penumbra::shadows
