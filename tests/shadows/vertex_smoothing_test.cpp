// Light that neighbouring vertices share: noise of few rays goes, edges of shadows stay.
#include "shadows/visibility/internal/vertex_smoothing.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/shadows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <random>

#include "core/conventions.h"
#include "tests/shadows/caster_world.h"

namespace penumbra::shadows {
namespace {

using test::CasterWorld;
using test::sheet;

lighting::DistantLight lamp_above(double radius_deg) {
  lighting::DistantLight d;
  d.direction = glm::normalize(glm::dvec3(.3, 1, .2));
  d.radius = Radians{radius_deg * kPi / 180};
  d.radiance = {1, 1, 1};
  return d;
}

// RMS of the fractions; where: all, or those that are marked.
double error_of(const std::vector<prt::CosineSums>& sums, const std::vector<float>& truth,
                const std::vector<char>& where = {}) {
  double sum = 0;
  int count = 0;
  for (std::size_t i = 0; i < sums.size(); ++i) {
    if (!where.empty() && !where[i]) continue;
    sum += std::pow(sums[i].seen / sums[i].open - truth[i], 2);
    ++count;
  }
  return std::sqrt(sum / count);
}

// So many random directions at each vertex, of which its true fraction is seen.
std::vector<prt::CosineSums> asked(const std::vector<float>& truth, int directions) {
  std::mt19937 random(5);
  std::vector<prt::CosineSums> out;
  for (const float p : truth) {
    std::binomial_distribution<int> seen(directions, double{p});
    out.push_back({static_cast<float>(seen(random)), static_cast<float>(directions)});
  }
  return out;
}

struct SharedErrors {
  double asked, averaged, ours;
};
SharedErrors share(const prt::Mesh& mesh, const std::vector<float>& truth, int directions,
                   const lighting::DistantLight& source, const std::vector<char>& where = {}) {
  std::vector<prt::CosineSums> sums = asked(truth, directions), averaged = sums, ours = sums;
  smooth_over_neighbours(mesh, smoothing_passes(source), averaged);
  const std::vector<std::uint8_t> counts(sums.size(), static_cast<std::uint8_t>(directions));
  smooth_noise_over_neighbours(mesh, source, counts, ours);
  return {error_of(sums, truth, where), error_of(averaged, truth, where),
          error_of(ours, truth, where)};
}

// A form with so far to its rim.
lighting::DistantLight form_above(double radius_deg) {
  lighting::DistantLight out = lamp_above(radius_deg);
  const glm::dvec3 across = glm::normalize(glm::cross(out.direction, glm::dvec3(0, 0, 1))),
                   along = glm::cross(out.direction, across);
  const double reach = std::tan(radius_deg * kPi / 180);
  for (int k = 0; k < lighting::DistantLight::kShapePoints; ++k) {
    const double r = reach * std::sqrt((k + .5) / lighting::DistantLight::kShapePoints),
                 angle = 2.399963 * k;
    out.shape.push_back(
        glm::normalize(out.direction + r * std::cos(angle) * across + r * std::sin(angle) * along));
  }
  return out;
}

TEST(SharedNoise, GoesWherePenumbrasAreWide) {
  const prt::Mesh mesh = sheet(60);
  std::vector<float> truth;
  for (const glm::vec3& p : mesh.positions) truth.push_back(.5f + .4f * p.x);
  for (const double radius_deg : {6., 20.})
    for (const int directions : {1, 2, 4, 8}) {
      const SharedErrors e = share(mesh, truth, directions, form_above(radius_deg));
      EXPECT_LT(e.ours, .55 * e.asked) << directions << ", " << radius_deg;
      EXPECT_LT(e.ours, 1.5 * e.averaged + .01) << directions << ", " << radius_deg;
    }
}

// Averages alone make two rows of vertices grey.
TEST(SharedNoise, AnEdgeSharperThanTheMeshStays) {
  const prt::Mesh mesh = sheet(60);
  std::vector<float> truth;
  for (const glm::vec3& p : mesh.positions) truth.push_back(p.x + .3f * p.z > .01f ? 1 : 0);
  for (const double radius_deg : {6., 20.}) {
    const SharedErrors e = share(mesh, truth, 4, lamp_above(radius_deg));
    EXPECT_GT(e.averaged, .05) << radius_deg;
    EXPECT_LT(e.ours, 1e-6) << radius_deg;
  }
}

// What casts the edge stands in the penumbra of something else.
TEST(SharedNoise, AnEdgeInsideAPenumbraStays) {
  const prt::Mesh mesh = sheet(60);
  std::vector<float> truth;
  std::vector<char> beside;
  for (const glm::vec3& p : mesh.positions) {
    const float off = p.x + .3f * p.z - .01f;
    truth.push_back(off > 0 ? .7f + .2f * p.z : 0);
    beside.push_back(std::abs(off) < .04f);
  }
  for (const int directions : {4, 8, 16}) {
    const SharedErrors e = share(mesh, truth, directions, form_above(6)),
                       there = share(mesh, truth, directions, form_above(6), beside);
    EXPECT_LT(e.ours, .7 * e.asked) << directions;
    EXPECT_LT(there.ours, .8 * there.averaged) << directions;
  }
}

// However their fractions came about.
TEST(SharedNoise, WhatIsKnownKeepsItsEdges) {
  const prt::Mesh mesh = sheet(30);
  std::vector<prt::CosineSums> sums;
  std::vector<std::uint8_t> counts(mesh.positions.size(), 0);
  for (const glm::vec3& p : mesh.positions) sums.push_back({p.x > 0 ? .8f : .3f, 1});
  const std::vector<prt::CosineSums> before = sums;
  smooth_noise_over_neighbours(mesh, form_above(6), counts, sums);
  for (std::size_t i = 0; i < sums.size(); ++i) EXPECT_NEAR(sums[i].seen, before[i].seen, 1e-6);
}

TEST(SharedNoise, VerticesWhoseDirectionsLieBehindThemTakeWhatIsAround) {
  const prt::Mesh mesh = sheet(4);
  std::vector<prt::CosineSums> sums(mesh.positions.size(), {1, 2});
  sums[12] = {};
  std::vector<std::uint8_t> counts(sums.size(), 4);
  counts[12] = 0;
  smooth_noise_over_neighbours(mesh, lamp_above(6), counts, sums);
  EXPECT_NEAR(sums[12].seen / sums[12].open, .5, 1e-6);
}

// A plate just above a coarse floor, under a lamp: its penumbra is a tenth of an edge wide.
TEST(SharedNoise, ContactShadowsOnCoarseMeshesStaySharp) {
  prt::Mesh plate = sheet(4, .4f);
  for (glm::vec3& p : plate.positions) p.y = .02f;
  const CasterWorld world({sheet(40), plate}, 1e-4f);
  const lighting::DistantLight source = lamp_above(8);
  ASSERT_TRUE(is_wide(source));
  const Caster alone{&world.points, &world.none, {}};
  const std::vector<float> dense = world.light(source, alone, &world.rays, 64),
                           ours = world.light(source, world.casters[0], &world.rays),
                           open = world.light(source, alone, nullptr);
  std::vector<prt::CosineSums> averaged;
  std::vector<float> truth;
  const std::vector<float> few = world.light(source, alone, &world.rays);
  double sum = 0;
  for (std::size_t i = 0; i < dense.size(); ++i) {
    averaged.push_back({few[i], open[i]});
    truth.push_back(dense[i] / open[i]);
    sum += std::pow(ours[i] / open[i] - truth[i], 2);
  }
  smooth_over_neighbours(world.meshes[0], 1, averaged);
  const double error = std::sqrt(sum / static_cast<double>(dense.size()));
  EXPECT_GT(error_of(averaged, truth), .05);
  EXPECT_LT(error, .015);
}

// Low light that the plane cuts: of four directions one or two are left at many vertices.
TEST(SharedNoise, ACutLightIsNoNoisierThanItsMean) {
  prt::Mesh wall = sheet(60), ball = prt::make_sphere({.9f, .5f, 0}, .35f, 3, {});
  for (std::size_t i = 0; i < wall.positions.size(); ++i) {
    const glm::vec3 p = wall.positions[i];
    wall.positions[i] = {-.5f, 1.1f + p.x, p.z};  // it stands on the plane and looks at the light
    wall.normals[i] = {1, 0, 0};
  }
  const CasterWorld world({wall, ball}, 1e-4f);
  const prt::Plane floor;
  lighting::DistantLight source = lamp_above(14);
  source.direction = glm::normalize(glm::dvec3(1, -.1, .1));
  const auto light = [&](const Caster& object, int samples) {
    std::vector<float> out(wall.positions.size());
    trace_direct_light({&world.rays, nullptr, 1e-4f}, {world.casters, {}, 1e-4f}, object, &floor,
                       source, samples, out);
    return out;
  };
  const Caster alone{&world.points, &world.none, {}};
  const std::vector<float> dense = light(alone, 64), few = light(alone, 4),
                           ours = light(world.casters[0], 4);
  double off = 0, off_alone = 0;
  for (std::size_t i = 0; i < dense.size(); ++i) {
    off += std::pow(ours[i] - dense[i], 2);
    off_alone += std::pow(few[i] - dense[i], 2);
  }
  ASSERT_GT(off_alone, 0);
  EXPECT_LT(off, .4 * off_alone);
}

TEST(SharedNoise, RealAndVirtualThingsTakeNoMoreThanThereIs) {
  prt::Mesh ground = sheet(60), near = sheet(2, .4f), far = sheet(2, .6f);
  for (glm::vec3& p : near.positions) p += glm::vec3(.1f, .02f, 0);
  for (glm::vec3& p : far.positions) p += glm::vec3(-.2f, 1.4f, .1f);
  prt::RayWorld virtual_things = *prt::RayWorld::create(), real_things = *prt::RayWorld::create();
  ASSERT_TRUE(virtual_things.add(near) && real_things.add(far));
  for (const bool form : {false, true}) {
    const lighting::DistantLight source = form ? form_above(12) : lamp_above(12);
    ASSERT_TRUE(is_wide(source));
    DirectLightAtVertices light;
    trace_direct_light_at_vertices({&virtual_things, &real_things, 1e-4f}, ground, source, 4,
                                   light);
    double by_real = 0, by_virtual = 0;
    for (std::size_t i = 0; i < light.open.size(); ++i) {
      EXPECT_GE(light.virtual_occlusion[i], 0);
      EXPECT_GE(light.real_occlusion[i], 0);
      EXPECT_LE(light.virtual_occlusion[i] + light.real_occlusion[i], 1.0001f * light.open[i]);
      by_real += light.real_occlusion[i], by_virtual += light.virtual_occlusion[i];
    }
    EXPECT_GT(by_real, 50);
    EXPECT_GT(by_virtual, 50);
  }
}

}  // namespace
}  // namespace penumbra::shadows
