// The materials of a whole scene, for the vertices of its world's mesh.
#include <gtest/gtest.h>

#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <memory>

#include "core/conventions.h"
#include "prt/geometry/local_material.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {
namespace {

PreparedObject ball(Rgb albedo, std::shared_ptr<const prt::SurfaceMaterials> surface) {
  PreparedObject out;
  out.baked.mesh = prt::make_sphere({0, 0, 0}, .2f, 1, albedo);
  out.baked.surface = std::move(surface);
  return out;
}

std::shared_ptr<const prt::SurfaceMaterials> two_materials(std::size_t vertices) {
  auto out = std::make_shared<prt::SurfaceMaterials>();
  out->materials = {{.name = "gold", .metallic = 1}, {.name = "clay", .metallic = 0}};
  out->material.assign(vertices, 0);
  out->material.back() = 1;
  out->coordinates[0].assign(vertices, {.25f, .75f});
  out->tangents.assign(vertices, {1, 0, 0, -1});
  return out;
}

PreparedScene three_things() {
  PreparedScene scene;
  scene.real_mesh = prt::make_box({-1, 0, -1}, {1, 1, 1}, 1, {.3f, .2f, .1f});
  scene.objects.push_back(ball({.6f, .5f, .4f}, nullptr));
  const std::size_t vertices = scene.objects[0].baked.mesh.positions.size();
  scene.objects.push_back(ball({0, 0, 0}, two_materials(vertices)));
  scene.objects.back().world_from_bake = {glm::angleAxis(kPi / 2, glm::dvec3(0, 1, 0)), {1, 2, 3}};
  scene.objects.push_back(ball({.5f, .5f, .5f}, two_materials(vertices)));
  scene.objects.back().visible = false;
  return scene;
}

TEST(WorldSurface, HasOneEntryForEachVertexOfTheWorldsMesh) {
  const PreparedScene scene = three_things();
  const auto surface = world_surface(scene, true);
  ASSERT_TRUE(surface && *surface);
  const prt::SurfaceMaterials& s = **surface;
  const prt::Mesh mesh = world_mesh(scene, true);
  ASSERT_TRUE(prt::check_surface(mesh, s));
  ASSERT_EQ(s.tint.size(), mesh.positions.size());
  const std::size_t first = scene.real_mesh.positions.size(),
                    vertices = scene.objects[0].baked.mesh.positions.size();
  EXPECT_EQ(s.materials[s.material[0]].specular, 0) << "real things are Lambertian";
  EXPECT_EQ(s.tint[0], (Rgb{.3f, .2f, .1f}));
  EXPECT_EQ(s.materials[s.material[first]].specular, 0);
  EXPECT_EQ(s.tint[first], (Rgb{.6f, .5f, .4f}));
  EXPECT_EQ(s.materials[s.material[first + vertices]].name, "gold");
  EXPECT_EQ(s.materials[s.material.back()].name, "clay");
  EXPECT_EQ(s.tint.back(), (Rgb{1, 1, 1}));
  EXPECT_EQ(s.coordinates[0].back(), (glm::vec2(.25f, .75f)));
  EXPECT_EQ(s.coordinates[1].back(), (glm::vec2(.25f, .75f))) << "the first set stands for both";
}

TEST(WorldSurface, TangentsTurnWithTheirObject) {
  const PreparedScene scene = three_things();
  const auto surface = world_surface(scene, true);
  ASSERT_TRUE(surface && *surface);
  const glm::vec4 t = (*surface)->tangents.back();
  EXPECT_LT(glm::distance(glm::vec3(t), glm::vec3(0, 0, -1)), 1e-6f);
  EXPECT_EQ(t.w, -1);
}

TEST(WorldSurface, IsNotThereWithoutMaterials) {
  PreparedScene scene = three_things();
  const auto real = world_surface(scene, false);
  ASSERT_TRUE(real);
  EXPECT_EQ(*real, nullptr);
  scene.objects.erase(scene.objects.begin() + 1);
  const auto plain = world_surface(scene, true);
  ASSERT_TRUE(plain);
  EXPECT_EQ(*plain, nullptr) << "what is not visible does not count";
}

TEST(WorldSurface, MoreMaterialsThanCanBeNumberedAreRefused) {
  PreparedScene scene = three_things();
  auto many = std::make_shared<prt::SurfaceMaterials>(*scene.objects[1].baked.surface);
  many->materials.resize(65'536);
  scene.objects[1].baked.surface = many;
  const auto surface = world_surface(scene, true);
  ASSERT_FALSE(surface);
  EXPECT_EQ(surface.error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::runtime
