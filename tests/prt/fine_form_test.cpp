// Meshes that are drawn in full and lit at few vertices.
#include "prt/rays/fine_form.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <vector>

#include "prt/rays/rays.h"

namespace penumbra::prt {
namespace {

Mesh fine_sphere() {
  return make_sphere({0, 0, 0}, 1, 6, {.5f, .5f, .5f});  // 40,962 vertices
}

std::vector<Rgb> light_on(const Mesh& mesh) {
  std::vector<Rgb> out;
  for (const glm::vec3& n : mesh.normals) out.push_back({2 + n.x, 2 + n.y, 2 + n.z});
  return out;
}

TEST(FineForms, FewVerticesHaveNearlyTheSameForm) {
  const Mesh fine = fine_sphere();
  const Simplified few = simplify(fine, 2000);
  EXPECT_LE(few.mesh.positions.size(), 2500U);
  EXPECT_GT(few.mesh.positions.size(), 1000U);
  EXPECT_LT(few.error, .01f);
  ASSERT_EQ(few.from.size(), few.mesh.positions.size());
  for (std::size_t i = 0; i < few.from.size(); ++i) {
    EXPECT_EQ(few.mesh.positions[i], fine.positions[few.from[i]]);
    EXPECT_EQ(few.mesh.normals[i], fine.normals[few.from[i]]);
  }
  for (const auto& t : few.mesh.triangles)
    for (const auto v : t) ASSERT_LT(v, few.mesh.positions.size());
}

// Ten thousand triangles that share nothing: no edge can be taken out.
TEST(FineForms, PartsThatNothingHoldsTogetherAreMerged) {
  Mesh crumbs;
  for (int i = 0; i < 10'000; ++i) {
    const auto x = static_cast<float>(i % 100), y = static_cast<float>(i / 100);
    const auto first = static_cast<std::uint32_t>(crumbs.positions.size());
    for (const glm::vec3& p :
         {glm::vec3(x, y, 0), glm::vec3(x + .8f, y, 0), glm::vec3(x, y + .8f, .1f)}) {
      crumbs.positions.push_back(p);
      crumbs.normals.emplace_back(0, 0, 1);
      crumbs.albedo.push_back({.5f, .5f, .5f});
    }
    crumbs.triangles.push_back({first, first + 1, first + 2});
  }
  const Simplified few = simplify(crumbs, 3000);
  EXPECT_LE(few.mesh.positions.size(), 9000U);
  EXPECT_FALSE(few.mesh.triangles.empty());
}

TEST(FineForms, EachVertexGetsTheLightOfItsPlace) {
  const Mesh fine = fine_sphere();
  const Simplified few = simplify(fine, 2000);
  const auto form = lit_by(fine, few.mesh);
  ASSERT_TRUE(form);
  const std::vector<Rgb> exact = light_on(fine), got = at_fine_vertices(*form, light_on(few.mesh));
  ASSERT_EQ(got.size(), exact.size());
  double worst = 0;
  for (std::size_t i = 0; i < got.size(); ++i)
    worst = std::max(
        {worst, std::abs(double(got[i].r) - exact[i].r), std::abs(double(got[i].g) - exact[i].g)});
  EXPECT_LT(worst, .03);
}

// A plate of 2 mm whose simpler form lies 3 mm lower: by distance alone its underside would be lit
// as its top.
TEST(FineForms, AThinPlatesSidesKeepApart) {
  const Mesh plate = make_box({-.5f, 0, -.5f}, {.5f, .002f, .5f}, 40, {.5f, .5f, .5f});
  const Mesh lower = make_box({-.5f, -.003f, -.5f}, {.5f, -.001f, .5f}, 4, {.5f, .5f, .5f});
  const auto form = lit_by(plate, lower);
  const auto scene = RayScene::build(lower);
  ASSERT_TRUE(form && scene);
  const std::vector<Rgb> got = at_fine_vertices(*form, light_on(lower));
  int naive_wrong = 0;
  for (std::size_t i = 0; i < got.size(); ++i) {
    const glm::vec3 &p = plate.positions[i], &n = plate.normals[i];
    if (std::abs(n.y) < .9f || std::max(std::abs(p.x), std::abs(p.z)) > .49f) continue;
    EXPECT_NEAR(got[i].g, 2 + n.y, .01) << p.y;
    naive_wrong += n.y < 0 && scene->nearest(p, n, 0).front == false ? 1 : 0;
  }
  EXPECT_GT(naive_wrong, 100);
}

TEST(FineForms, TheNearestPlaceIsThatOfAllTriangles) {
  const Mesh knot = make_knot(1, 60, 10, {.5f, .5f, .5f});
  const auto scene = RayScene::build(knot);
  ASSERT_TRUE(scene);
  for (int i = 0; i < 200; ++i) {
    const auto t = static_cast<float>(i);
    const glm::vec3 p(std::sin(1.3f * t), .5f + .5f * std::sin(2.1f * t), std::cos(.7f * t));
    // By many places of each triangle, which are never nearer.
    float nearest = 1e9f;
    for (const auto& [a, b, c] : knot.triangles)
      for (int u = 0; u <= 8; ++u)
        for (int v = 0; u + v <= 8; ++v) {
          const float fu = static_cast<float>(u) / 8, fv = static_cast<float>(v) / 8;
          const glm::vec3 q =
              knot.positions[a] * (1 - fu - fv) + knot.positions[b] * fu + knot.positions[c] * fv;
          nearest = std::min(nearest, glm::length(q - p));
        }
    const Hit hit = scene->nearest(p, {0, 1, 0}, 0);
    const auto& [a, b, c] = knot.triangles[hit.triangle];
    const glm::vec3 at = knot.positions[a] * (1 - hit.u - hit.v) + knot.positions[b] * hit.u +
                         knot.positions[c] * hit.v;
    EXPECT_NEAR(glm::length(at - p), hit.distance, 1e-5);
    EXPECT_LE(hit.distance, nearest + 1e-5f);
    EXPECT_GT(hit.distance, nearest - .03f);
  }
}

TEST(FineForms, MaterialsArePickedVertexByVertex) {
  SurfaceMaterials all;
  all.materials.resize(2);
  all.material = {0, 1, 1, 0};
  all.coordinates[0] = {{0, 0}, {1, 0}, {2, 0}, {3, 0}};
  const std::vector<std::uint32_t> from = {3, 1};
  const SurfaceMaterials some = picked(all, from);
  EXPECT_EQ(some.materials.size(), 2U);
  EXPECT_EQ(some.material, (std::vector<std::uint16_t>{0, 1}));
  EXPECT_EQ(some.coordinates[0][0].x, 3);
  EXPECT_TRUE(some.coordinates[1].empty());
  EXPECT_TRUE(some.tint.empty());
}

}  // namespace
}  // namespace penumbra::prt
