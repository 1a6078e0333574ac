// What probes on an object see of a wall and of the floor, and how vertices take it from them.
#include "runtime/surroundings/occlusion_probes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "prt/prt.h"
#include "tests/support/ball_and_wall.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;

// A ball of 20 cm in front of a wall of 4 x 4 m that stands at x = -1/2 m.
class ProbesBesideAWall : public testing::Test, public test::BallAndWall {
 protected:
  ProbesBesideAWall()
      : BallAndWall({{{-.5f, 0, -2}, {-.5f, 4, -2}, {-.5f, 4, 2}, {-.5f, 0, 2}}}, {1, 0, 0},
                    {.5f, .5f, .5f}) {
    scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.5f, .5f, .5f}, {}});
  }
};

TEST_F(ProbesBesideAWall, FractionsAreFormFactors) {
  OcclusionProbes probes(scene);
  const Pose here;
  probes.update(occluders(), {&here, 1});
  std::array<int, OcclusionProbes::kProbes> wall{}, floor{};
  std::array<glm::vec3, OcclusionProbes::kProbes> normal{};
  for (const ProbeHit& hit : probes.hits(0)) {
    if (hit.thing == ProbeHit::kProbe) normal[hit.probe] = hit.direction;
    wall[hit.probe] += hit.thing == ProbeHit::kReal;
    floor[hit.probe] += hit.thing == ProbeHit::kFloor;
    EXPECT_NE(hit.thing, ProbeHit::kItself) << "a ball does not see itself";
    if (hit.thing == ProbeHit::kFloor) {
      EXPECT_NEAR(hit.point.y, 0, 1e-4);
    }
  }
  for (std::size_t p = 0; p < OcclusionProbes::kFewProbes; ++p) {
    const glm::vec3& n = normal[p];
    ASSERT_NEAR(glm::length(n), 1, 1e-4) << "each probe is among its hits";
    // The floor fills (1 - n.y)/2 of what is around, less what the wall hides of it.
    EXPECT_LE(floor[p] / double(OcclusionProbes::kRays), (1 - double(n.y)) / 2 + .06);
    if (n.x > .2f) {
      EXPECT_NEAR(floor[p] / double(OcclusionProbes::kRays), (1 - n.y) / 2, .12);
    }
    if (n.x > .999f) {
      EXPECT_EQ(wall[p], 0);
    }
    if (n.x < -.9f) {
      EXPECT_GT(wall[p], OcclusionProbes::kRays / 3);
    }
  }
  const double hidden = double(probes.by_real(0).size()) / OcclusionProbes::kSphereRays;
  EXPECT_GT(hidden, .15);
  EXPECT_LT(hidden, .5);
  for (const RealHit& hit : probes.by_real(0)) EXPECT_LT(hit.direction.x, 0);
  EXPECT_FALSE(probes.open_rays(0).empty());
}

// Once it stands, and no sooner; what moves is looked from with few rays of few probes again.
TEST_F(ProbesBesideAWall, MoreRaysOfMoreProbesTellMoreOfAnObjectThatStands) {
  OcclusionProbes probes(scene);
  const Pose here, there{{1, 0, 0, 0}, dvec3(.1, 0, 0)};
  const auto off = [&] {  // RMS, from the form factor of the open floor
    std::array<double, OcclusionProbes::kProbes> floor{};
    for (const ProbeHit& hit : probes.hits(0))
      floor[hit.probe] += hit.thing == ProbeHit::kFloor ? 1. / probes.rays(0) : 0;
    double sum = 0, count = 0;
    for (const ProbeHit& hit : probes.hits(0))
      if (hit.thing == ProbeHit::kProbe && hit.direction.x > .2f) {
        sum += std::pow(floor[hit.probe] - (1 - double(hit.direction.y)) / 2, 2);
        ++count;
      }
    return std::sqrt(sum / count);
  };
  const prt::Mesh& mesh = scene.objects[0].baked.mesh;
  const auto off_between = [&] {  // the same at vertices, which lie between probes
    std::vector<Rgb> floor(OcclusionProbes::kProbes);
    for (const ProbeHit& hit : probes.hits(0))
      if (hit.thing == ProbeHit::kFloor)
        floor[hit.probe].r += 1.f / static_cast<float>(probes.rays(0));
    double sum = 0, count = 0;
    for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
      if (!(mesh.normals[v].x > .2f)) continue;
      const float at = probes.at_vertex(0, floor, v).r;
      sum += std::pow(double(at) - (1 - double(mesh.normals[v].y)) / 2, 2);
      ++count;
    }
    return std::sqrt(sum / count);
  };
  probes.update(occluders(), {&here, 1});
  EXPECT_FALSE(probes.refine(occluders(), true)) << "nobody asked";
  const double coarse = off(), coarse_between = off_between();
  const std::uint32_t before = probes.hits_version(0);
  probes.want_fine(0, true);
  EXPECT_TRUE(probes.refine(occluders(), true));
  EXPECT_FALSE(probes.refine(occluders(), true)) << "there is nothing finer";
  EXPECT_NE(probes.hits_version(0), before);
  EXPECT_EQ(probes.rays(0), OcclusionProbes::kFineRays);
  EXPECT_LT(off(), .5 * coarse);
  EXPECT_LT(off_between(), .6 * coarse_between);
  EXPECT_TRUE(probes.is_fine(0));
  // Dragged in steps of some frames it is not looked at finely between them.
  for (const Pose& step : {there, here, there}) {
    probes.update(occluders(), {&step, 1});
    EXPECT_EQ(probes.rays(0), OcclusionProbes::kRays);
    for (int frame = 1; frame < OcclusionProbes::kStillFrames; ++frame) {
      probes.update(occluders(), {&step, 1});
      EXPECT_FALSE(probes.refine(occluders())) << frame;
    }
  }
  EXPECT_TRUE(probes.refine(occluders()));
  EXPECT_EQ(probes.rays(0), OcclusionProbes::kFineRays);
}

// From what the bake has, where all is lit, to what was gathered, where nothing is.
TEST_F(ProbesBesideAWall, ShadedLightIsReplacedByWhatWasGathered) {
  const OcclusionProbes probes(scene);
  const std::size_t vertices = scene.objects[0].baked.mesh.positions.size();
  const std::vector<float> by_bake(3 * vertices, 2.f);
  std::array<Rgb, OcclusionProbes::kProbes> gathered;
  gathered.fill({.3f, .2f, .1f});
  OcclusionProbes::Values whole;
  whole.fill(4);
  for (const float lit : {1.f, .5f, 0.f}) {
    OcclusionProbes::Values part;
    part.fill(4 * lit);
    std::vector<float> out(3 * vertices, 5.f);
    probes.replace_shaded(0, part, whole, gathered, by_bake, out);
    for (std::size_t v = 0; v < vertices; v += 7)
      for (std::size_t c = 0; c < 3; ++c)
        ASSERT_NEAR(out[c * vertices + v],
                    3 + lit * lit * 2 + (1 - lit) * gathered[0][static_cast<int>(c)], 1e-4)
            << lit;
  }
}

// Looking again from the same place costs nothing; from another one it is seen anew.
TEST_F(ProbesBesideAWall, FollowTheObject) {
  OcclusionProbes probes(scene);
  const Pose here, far{{1, 0, 0, 0}, dvec3(1e4, 0, 0)};
  const auto sees_wall = [&] {
    return std::ranges::any_of(probes.hits(0),
                               [](const ProbeHit& h) { return h.thing == ProbeHit::kReal; });
  };
  probes.update(occluders(), {&here, 1});
  EXPECT_TRUE(sees_wall());
  real_things->set_pose(0, far);  // behind the probes' back: only poses of objects are looked at
  probes.update(occluders(), {&here, 1});
  EXPECT_TRUE(sees_wall()) << "rays were cast though nothing has moved";
  real_things->set_pose(0, here);
  virtual_things->set_pose(0, far);
  probes.update(occluders(), {&far, 1});
  EXPECT_FALSE(sees_wall());
}

TEST_F(ProbesBesideAWall, WhatAllProbesHaveAllVerticesGet) {
  const OcclusionProbes probes(scene);
  const std::size_t count = scene.objects[0].baked.mesh.positions.size();
  std::vector<float> out(3 * count, 1.f);
  probes.spread(0, std::vector<Rgb>(OcclusionProbes::kProbes, Rgb{1, 2, -1}), out);
  for (std::size_t v = 0; v < count; ++v) {
    ASSERT_NEAR(out[v], 2, 1e-4);
    ASSERT_NEAR(out[count + v], 3, 1e-4);
    ASSERT_NEAR(out[2 * count + v], 0, 1e-4);
  }
  OcclusionProbes::Values part, whole, nothing{};
  part.fill(1), whole.fill(4);
  const std::vector<float> reflected(3 * count, 8.f);
  std::ranges::fill(out, 10.f);
  probes.take_missing(0, part, whole, reflected, out);
  for (const float x : out) ASSERT_NEAR(x, 10 - .75 * 8, 1e-4);
  probes.take_missing(0, nothing, nothing, reflected, out);
  for (const float x : out) ASSERT_NEAR(x, 4, 1e-4) << "no floor in sight";
}

// A smooth field over the surface comes out smooth: no vertex is far from its neighbours' mean.
TEST_F(ProbesBesideAWall, ASlopeStaysASlope) {
  OcclusionProbes probes(scene);
  const Pose here;
  probes.update(occluders(), {&here, 1});
  std::vector<Rgb> values(OcclusionProbes::kProbes);
  for (const ProbeHit& hit : probes.hits(0))
    if (hit.thing == ProbeHit::kProbe) values[hit.probe] = Rgb{1, 1, 1} * hit.direction.x;
  const prt::Mesh& mesh = scene.objects[0].baked.mesh;
  std::vector<float> out(3 * mesh.positions.size(), 0.f);
  probes.spread(0, values, out);
  for (std::size_t v = 0; v < mesh.positions.size(); ++v)
    ASSERT_NEAR(out[v], mesh.normals[v].x, .25) << v;
}

// Two objects over one plane, of which one was baked without a floor: the plane is nobody's
// surroundings, and what lies below is the sky's as in the bake.
TEST(OcclusionProbes, OnePlaneIsNotAround) {
  test::BallAndWall world({{{-90, 0, -1}, {-90, 1, -1}, {-90, 1, 1}, {-90, 0, 1}}}, {1, 0, 0}, {});
  world.scene.real_mesh = {};
  world.scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.5f, .5f, .5f}, {}});
  world.scene.objects.push_back(world.scene.objects[0]);
  world.scene.objects[1].baked.receiver.reset();
  ASSERT_TRUE(world.virtual_things->add(world.scene.objects[1].baked.mesh));
  const Pose poses[] = {{}, {{1, 0, 0, 0}, dvec3(2, .5, 0)}};
  world.virtual_things->set_pose(1, poses[1]);
  OcclusionProbes probes(world.scene);
  EXPECT_FALSE(probes.any_real());
  probes.update(world.occluders(), poses);
  for (std::size_t i = 0; i < 2; ++i)
    for (const ProbeHit& hit : probes.hits(i)) EXPECT_NE(hit.thing, ProbeHit::kReal) << i;
  EXPECT_TRUE(probes.by_real(1).empty());
}

// A ball that turns or creeps leaves its neighbours alone until that has come to a visible change;
// what jumps is seen at once, and in the end all have looked.
TEST(OcclusionProbes, OnlyWhatSeesAGoodDealOfAMoveLooksAgain) {
  test::BallAndWall world({{{-90, 0, -1}, {-90, 1, -1}, {-90, 1, 1}, {-90, 0, 1}}}, {1, 0, 0}, {});
  world.scene.real_mesh = {};
  world.scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.5f, .5f, .5f}, {}});
  std::vector<Pose> poses{{}};
  for (const double x : {.8, 1.6, 8.}) {
    world.scene.objects.push_back(world.scene.objects[0]);
    ASSERT_TRUE(world.virtual_things->add(world.scene.objects[0].baked.mesh));
    poses.push_back({{1, 0, 0, 0}, dvec3(x, 0, 0)});
  }
  OcclusionProbes probes(world.scene);
  const auto looks_after = [&](std::size_t moved, const Pose& pose) {
    std::array<std::uint32_t, 4> before{}, out{};
    for (std::size_t i = 0; i < 4; ++i) before[i] = probes.hits_version(i);
    poses[moved] = pose;
    for (std::size_t i = 0; i < 4; ++i)
      world.virtual_things->set_pose(static_cast<int>(i), poses[i]);
    probes.update(world.occluders(), poses);
    for (std::size_t i = 0; i < 4; ++i) out[i] = probes.hits_version(i) - before[i];
    return out;
  };
  using Looks = std::array<std::uint32_t, 4>;
  EXPECT_EQ(looks_after(0, {}), (Looks{1, 1, 1, 1})) << "the first time";
  const auto turned = [](double angle) {
    return Pose{glm::angleAxis(angle, dvec3(0, 1, 0)), {0, 0, 0}};
  };
  EXPECT_EQ(looks_after(0, turned(.01)), (Looks{1, 0, 0, 0})) << "a turntable";
  EXPECT_EQ(looks_after(0, {{1, 0, 0, 0}, dvec3(0, 0, 1)}), (Looks{1, 1, 1, 0})) << "a jump";
  EXPECT_EQ(looks_after(0, poses[0]), (Looks{0, 0, 0, 1})) << "all stand: the last has its turn";
  // It creeps: the nearest has its turn first, the farthest hardly ever.
  Looks sum{};
  for (int step = 0; step < 60; ++step) {
    const Looks now = looks_after(0, {{1, 0, 0, 0}, dvec3(0, 0, .99 - .01 * step)});
    EXPECT_LE(now[1] + now[2] + now[3], 1u) << step;
    for (std::size_t i = 0; i < 4; ++i) sum[i] += now[i];
  }
  EXPECT_EQ(sum[0], 60u);
  EXPECT_GT(sum[1], sum[2]);
  EXPECT_GT(sum[2], sum[3]);
  EXPECT_LT(sum[1], 20u);
  // Then all stand: each looks once more at most, and then none does.
  for (int frame = 0; frame < 4; ++frame) (void)looks_after(0, poses[0]);
  EXPECT_EQ(looks_after(0, poses[0]), Looks{});
}

TEST(OcclusionProbes, AnObjectAloneOnAFloorSeesNothing) {
  PreparedScene scene;
  scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.5f, .5f, .5f}, {}});
  PreparedObject& o = scene.objects.emplace_back();
  o.baked.mesh = prt::make_sphere({0, .2f, 0}, .2f, 2, {1, 1, 1});
  EXPECT_FALSE(OcclusionProbes(scene).any());
}

}  // namespace
}  // namespace penumbra::runtime
