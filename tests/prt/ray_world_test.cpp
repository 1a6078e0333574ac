// The nearest hit among meshes at poses, against each mesh alone.
#include <gtest/gtest.h>

#include "prt/prt.h"

namespace penumbra::prt {
namespace {

using glm::dvec3;

TEST(RayWorld, NearestOfSeveralMeshesIsThatOfEachAlone) {
  const Mesh ball = make_sphere({0, 0, 0}, 1, 3, {1, 1, 1});
  const Pose near{{1, 0, 0, 0}, dvec3(-1.2, 0, -3)};
  const Pose far{glm::dquat(.8, 0, .6, 0), dvec3(.3, 0, -6)};
  auto world = RayWorld::create();
  ASSERT_TRUE(world);
  ASSERT_EQ(*world->add(ball), 0);
  ASSERT_EQ(*world->add(ball), 1);
  world->set_pose(0, near);
  world->set_pose(1, far);
  const auto alone = RayScene::build(ball);
  ASSERT_TRUE(alone);

  RayWorld::Rays rays;
  for (int i = 0; i < RayWorld::kPacket; ++i) {
    const glm::vec3 d = glm::normalize(glm::vec3(-.7f + .08f * float(i), .01f, -1));
    rays.ox[i] = rays.oy[i] = rays.oz[i] = 0;
    rays.dx[i] = d.x, rays.dy[i] = d.y, rays.dz[i] = d.z;
  }
  RayWorld::Hits hits;
  world->intersect(1, rays, hits);  // the far one first: the near one takes its place
  world->intersect(0, rays, hits);
  int near_hits = 0, far_hits = 0, none = 0;
  for (int i = 0; i < RayWorld::kPacket; ++i) {
    const dvec3 d(rays.dx[i], rays.dy[i], rays.dz[i]);
    const auto met = [&](const Pose& pose) {
      const Pose inverse = pose.inverse();
      return alone->intersect(glm::vec3(inverse.translation), glm::vec3(inverse.rotation * d), 0);
    };
    const auto by_near = met(near), by_far = met(far);
    const auto& expected = by_near ? by_near : by_far;
    ASSERT_EQ(hits.mesh[i], by_near ? 0 : by_far ? 1 : -1) << i;
    ++(by_near ? near_hits : by_far ? far_hits : none);
    if (!expected) continue;
    EXPECT_NEAR(hits.distance[i], expected->distance, 1e-4);
    EXPECT_EQ(hits.triangle[i], expected->triangle);
    EXPECT_NEAR(hits.u[i], expected->u, 1e-3);
    EXPECT_NEAR(hits.v[i], expected->v, 1e-3);
  }
  EXPECT_GT(near_hits, 2);
  EXPECT_GT(far_hits, 2);
  EXPECT_GT(none, 2);
}

}  // namespace
}  // namespace penumbra::prt
