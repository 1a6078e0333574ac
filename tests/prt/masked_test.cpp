// Masks as geometry: what they cut away blocks no ray.
#include "prt/geometry/masked.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "core/conventions.h"

namespace penumbra::prt {
namespace {

// A sheet of 1 m whose mask keeps a disc of .3 m radius.
struct Sheet {
  Mesh mesh;
  SurfaceMaterials materials;
};
Sheet make_sheet(Material::Alpha alpha) {
  Sheet out;
  out.mesh.positions = {{0, 0, 0}, {1, 0, 0}, {1, 0, 1}, {0, 0, 1}};
  out.mesh.normals.assign(4, {0, 1, 0});
  out.mesh.albedo.assign(4, {.5f, .5f, .5f});
  out.mesh.triangles = {{0, 2, 1}, {0, 3, 2}};
  auto picture = std::make_shared<TexturePicture>();
  picture->codes = Image<Rgba8>(256, 256);
  for (int y = 0; y < 256; ++y)
    for (int x = 0; x < 256; ++x)
      picture->codes.at(x, y).a = std::hypot(x - 127.5, y - 127.5) < .3 * 256 ? 255 : 0;
  Material leaf;
  leaf.base_colour_map.picture = picture;
  leaf.alpha = alpha;
  out.materials.materials = {leaf};
  out.materials.material.assign(4, 0);
  out.materials.coordinates[0] = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  return out;
}

double sheet_area(const Mesh& mesh) {
  double sum = 0;
  for (const auto& [a, b, c] : mesh.triangles)
    sum += .5 * glm::length(glm::cross(mesh.positions[b] - mesh.positions[a],
                                       mesh.positions[c] - mesh.positions[a]));
  return sum;
}

TEST(Masked, WhatIsLeftHasTheAreaThatTheMaskLeaves) {
  Sheet sheet = make_sheet(Material::Alpha::kMask);
  ASSERT_TRUE(cut_masked_away(sheet.mesh, sheet.materials, .02f));
  EXPECT_NEAR(sheet_area(sheet.mesh), kPi * .09, .005);
  for (const auto& t : sheet.mesh.triangles)
    for (const std::uint32_t v : t)
      EXPECT_LT(glm::distance(sheet.mesh.positions[v], glm::vec3(.5f, 0, .5f)), .325);
  // No vertex is baked for nothing, and all that belongs to one stays with it.
  EXPECT_EQ(sheet.materials.material.size(), sheet.mesh.positions.size());
  ASSERT_EQ(sheet.materials.coordinates[0].size(), sheet.mesh.positions.size());
  for (std::size_t v = 0; v < sheet.mesh.positions.size(); ++v) {
    EXPECT_NEAR(sheet.materials.coordinates[0][v].x, sheet.mesh.positions[v].x, 1e-6);
    EXPECT_NEAR(sheet.materials.coordinates[0][v].y, sheet.mesh.positions[v].z, 1e-6);
  }
}

TEST(Masked, OpaqueAndBlendedSurfacesStayWhole) {
  for (const auto alpha : {Material::Alpha::kOpaque, Material::Alpha::kBlend}) {
    Sheet sheet = make_sheet(alpha);
    EXPECT_FALSE(cut_masked_away(sheet.mesh, sheet.materials, .02f));
    EXPECT_EQ(sheet.mesh.triangles.size(), 2U);
    EXPECT_EQ(sheet.mesh.positions.size(), 4U);
  }
}

TEST(Masked, TrianglesAreNoMoreThanTheLimit) {
  Sheet sheet = make_sheet(Material::Alpha::kMask);
  cut_masked_away(sheet.mesh, sheet.materials, 1e-4f, 5000);
  EXPECT_LE(sheet.mesh.triangles.size(), 5000U);
  EXPECT_NEAR(sheet_area(sheet.mesh), kPi * .09, .03);
}

TEST(Masked, TheMaskFollowsWrapAndTransform) {
  Sheet sheet = make_sheet(Material::Alpha::kMask);
  Material& m = sheet.materials.materials[0];
  EXPECT_EQ(opacity_at(m, {.5f, .5f}), 1);
  EXPECT_EQ(opacity_at(m, {.05f, .05f}), 0);
  EXPECT_EQ(opacity_at(m, {3.5f, -1.5f}), 1);  // repeated
  m.base_colour_map.wrap_s = m.base_colour_map.wrap_t = Texture::Wrap::kClamp;
  EXPECT_EQ(opacity_at(m, {3.5f, .5f}), 0);
  m.base_colour_map.transform = {2, 0, 0, 2, 0, 0};
  EXPECT_EQ(opacity_at(m, {.25f, .25f}), 1);
}

}  // namespace
}  // namespace penumbra::prt
