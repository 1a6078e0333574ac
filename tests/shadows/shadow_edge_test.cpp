#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "shadows/shadows.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

lighting::DistantLight low_sun(double radius = .0047) {
  lighting::DistantLight d;
  d.direction = glm::normalize(glm::dvec3(.5, .8, .3));
  d.radius = Radians(radius);
  d.radiance = {1, 1, 1};
  return d;
}

// A coarse sheet of two metres with waves, under a ball.
test::CasterWorld waves_under_a_ball() {
  prt::Mesh sheet = test::sheet(20);
  for (std::size_t i = 0; i < sheet.positions.size(); ++i) {
    glm::vec3& p = sheet.positions[i];
    p.y = .12f * std::sin(5 * p.x) * std::sin(4 * p.z);
    sheet.normals[i] =
        glm::normalize(glm::vec3(-.12f * 5 * std::cos(5 * p.x) * std::sin(4 * p.z), 1,
                                 -.12f * 4 * std::sin(5 * p.x) * std::cos(4 * p.z)));
  }
  return {{sheet, prt::make_sphere({.2f, .7f, .1f}, .35f, 4, {1, 1, 1})}, 1e-3f};
}

struct Errors {
  double plain = 0, edged = 0;  // RMS of the mean cosine between vertices
};

// Against 64 rays from points all over the lit mesh.
Errors errors_between_vertices(const test::CasterWorld& world, const Pose& pose,
                               const lighting::DistantLight& source) {
  Caster object = world.casters[0];
  object.world_from_mesh = pose;
  const prt::Mesh& mesh = world.meshes[0];
  std::vector<float> plain(mesh.positions.size()), with = plain;
  EdgedFractions edged;
  const RayOccluders occluders{&world.rays, nullptr, world.near_m};
  const ShadowCasters casters{world.casters, {}, world.near_m};
  trace_direct_light(occluders, casters, object, nullptr, source, 16, plain);
  trace_direct_light(occluders, casters, object, nullptr, source, 16, with, &edged);
  EXPECT_EQ(edged.lit.size(), plain.size());
  if (edged.lit.size() != plain.size()) return {};
  std::mt19937 rng(7);
  prt::Mesh points;
  struct At {
    std::array<std::uint32_t, 3> corners;
    glm::vec3 weights;
  };
  std::vector<At> at;
  for (const auto& t : mesh.triangles)
    for (int k = 0; k < 4; ++k) {
      const float a = std::sqrt(float(rng()) * 0x1p-32f), b = float(rng()) * 0x1p-32f;
      const glm::vec3 w(1 - a, a * (1 - b), a * b);
      at.push_back({t, w});
      const auto mixed = [&](const std::vector<glm::vec3>& v) {
        return w.x * v[t[0]] + w.y * v[t[1]] + w.z * v[t[2]];
      };
      points.positions.emplace_back(pose * glm::dvec3(mixed(mesh.positions)));
      points.normals.emplace_back(glm::normalize(pose.rotation * glm::dvec3(mixed(mesh.normals))));
    }
  DirectLightAtVertices truth;
  trace_direct_light_at_vertices(occluders, points, source, 64, truth);
  Errors out;
  for (std::size_t i = 0; i < at.size(); ++i) {
    const auto& [t, w] = at[i];
    const auto between = [&](const std::vector<float>& v) {
      return w.x * v[t[0]] + w.y * v[t[1]] + w.z * v[t[2]];
    };
    const double expected = truth.open[i] - truth.virtual_occlusion[i];
    out.plain += std::pow(between(plain) - expected, 2);
    out.edged +=
        std::pow(between(edged.open) * std::clamp(between(edged.lit), 0.f, 1.f) - expected, 2);
  }
  return {std::sqrt(out.plain / double(at.size())), std::sqrt(out.edged / double(at.size()))};
}

// By its vertices alone the mesh shows the ball's shadow, and its own waves', in steps of its
// triangles.
TEST(ShadowEdge, RunsBetweenVerticesWhereItIs) {
  const test::CasterWorld world = waves_under_a_ball();
  const Errors e = errors_between_vertices(world, {}, low_sun());
  std::printf("RMS of the cosine between vertices: %.4f by vertices, %.4f with edges\n", e.plain,
              e.edged);
  EXPECT_GT(e.plain, .06);
  EXPECT_LT(e.edged, .55 * e.plain);
}

// Where the mesh stands does not matter, nor does the frame in which it is told.
TEST(ShadowEdge, GoesWithTheMesh) {
  test::CasterWorld world = waves_under_a_ball();
  const Errors here = errors_between_vertices(world, {}, low_sun());
  const glm::dquat turn = glm::angleAxis(.7, glm::normalize(glm::dvec3(.2, 1, .1)));
  const Pose there{turn, {3, -1, 2}};
  for (int i = 0; i < 2; ++i) world.rays.set_pose(i, there);
  for (Caster& c : world.casters) c.world_from_mesh = there;
  lighting::DistantLight turned = low_sun();
  turned.direction = turn * turned.direction;
  const Errors moved = errors_between_vertices(world, there, turned);
  EXPECT_NEAR(moved.edged, here.edged, .1 * here.edged);
}

// What looks away from the light, or lies in it as a whole, has no edge.
TEST(ShadowEdge, VerticesBesideNoEdgeKeepTheirFraction) {
  const test::CasterWorld world({prt::make_sphere({0, 0, 0}, .5f, 3, {1, 1, 1})}, 1e-3f);
  std::vector<float> out(world.meshes[0].positions.size());
  EdgedFractions edged;
  trace_direct_light({&world.rays, nullptr, world.near_m}, {world.casters, {}, world.near_m},
                     world.casters[0], nullptr, low_sun(), 4, out, &edged);
  ASSERT_EQ(edged.lit.size(), out.size());
  for (std::size_t i = 0; i < out.size(); ++i) {
    EXPECT_NEAR(edged.open[i] * std::clamp(edged.lit[i], 0.f, 1.f), out[i], 1e-3) << i;
    const double up = glm::dot(glm::dvec3(world.meshes[0].normals[i]), low_sun().direction);
    if (up > .2) {
      EXPECT_EQ(edged.lit[i], 1) << i;
    } else if (up < -.2) {
      EXPECT_EQ(edged.open[i], 0) << i;
    }
  }
}

// A light whose penumbras are wider than the mesh's edges has none that is sharper.
TEST(ShadowEdge, WideLightsHaveNone) {
  const test::CasterWorld world = waves_under_a_ball();
  std::vector<float> out(world.meshes[0].positions.size());
  EdgedFractions edged{{1}, {1}};
  trace_direct_light({&world.rays, nullptr, world.near_m}, {world.casters, {}, world.near_m},
                     world.casters[0], nullptr, low_sun(.1), 4, out, &edged);
  EXPECT_TRUE(edged.lit.empty());
  EXPECT_TRUE(edged.open.empty());
}

}  // namespace
}  // namespace penumbra::shadows
