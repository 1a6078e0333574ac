// Surfaces that emit, as points.
#include "prt/geometry/luminous.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <memory>

#include "core/conventions.h"

namespace penumbra::prt {
namespace {

// Strips of a square metre in the x-z plane, one material after another.
struct StripedSquare {
  Mesh mesh;
  SurfaceMaterials surface;

  explicit StripedSquare(std::vector<Material> materials) {
    const auto count = static_cast<std::uint32_t>(materials.size());
    for (std::uint32_t m = 0; m < count; ++m) {
      const float x0 = static_cast<float>(m) / static_cast<float>(count),
                  x1 = static_cast<float>(m + 1) / static_cast<float>(count);
      for (const glm::vec2 p : {glm::vec2(x0, 0), {x0, 1}, {x1, 1}, {x1, 0}}) {
        mesh.positions.emplace_back(p.x, 0, p.y);
        mesh.normals.emplace_back(0, 1, 0);
        mesh.albedo.push_back({.5f, .5f, .5f});
        surface.coordinates[0].push_back(p);
        surface.material.push_back(static_cast<std::uint16_t>(m));
      }
      mesh.triangles.push_back({4 * m, 4 * m + 1, 4 * m + 2});
      mesh.triangles.push_back({4 * m, 4 * m + 2, 4 * m + 3});
    }
    surface.materials = std::move(materials);
  }

  glm::vec3 at(const TrianglePlace& p) const {
    const auto& c = p.corners;
    return (1 - p.u - p.v) * mesh.positions[c[0]] + p.u * mesh.positions[c[1]] +
           p.v * mesh.positions[c[2]];
  }
};

TEST(Luminous, OnlyWhatEmitsIsAPartAndItSendsEmissionTimesArea) {
  const StripedSquare square({{.name = "matt"},
                              {.name = "sign", .emission = {4, 2, 1}, .double_sided = true},
                              {.name = "painted", .emission = {1, 1, 1}, .unlit = true},
                              {.name = "lamp", .emission = {0, 0, 8}}});
  const auto parts = luminous_parts(square.mesh, square.surface, 16);
  ASSERT_EQ(parts.size(), 2u);
  EXPECT_EQ(parts[0].material, "sign");
  EXPECT_TRUE(parts[0].double_sided);
  EXPECT_FALSE(parts[1].double_sided);
  EXPECT_NEAR(parts[0].emission_m2.r, 1, 1e-6);
  EXPECT_NEAR(parts[0].emission_m2.g, .5, 1e-6);
  EXPECT_NEAR(parts[1].emission_m2.b, 2, 1e-6);
  EXPECT_NEAR(parts[0].point_m2, .25 / 16, 1e-7);
  ASSERT_EQ(parts[0].points.size(), 16u);
  for (const TrianglePlace& p : parts[0].points) {
    EXPECT_GE(square.at(p).x, .25f);
    EXPECT_LE(square.at(p).x, .5f);
  }
}

TEST(Luminous, PointsLieWhereTheLightIs) {
  // The left half of the picture is three times as bright as the right one.
  auto picture = std::make_shared<TexturePicture>();
  picture->codes = Image<Rgba8>(2, 1);
  picture->codes.at(0, 0) = {255, 255, 255, 255};
  picture->codes.at(1, 0) = {156, 156, 156, 255};  // linear .333
  Material painted{.name = "screen", .emission = {3, 3, 3}};
  painted.emission_map.picture = picture;
  painted.emission_map.nearest = true;
  const StripedSquare halves({painted, painted});
  SurfaceMaterials one = halves.surface;
  one.materials.resize(1);
  std::ranges::fill(one.material, std::uint16_t{0});
  const auto parts = luminous_parts(halves.mesh, one, 64);
  ASSERT_EQ(parts.size(), 1u);
  EXPECT_NEAR(parts[0].emission_m2.r, .5 * 3 + .5 * 1, .01);
  const auto left = std::ranges::count_if(
      parts[0].points, [&](const TrianglePlace& p) { return halves.at(p).x < .5f; });
  EXPECT_EQ(left, 48);
}

TEST(Luminous, PointsAreSpreadOverALargeTriangle) {
  const StripedSquare square({{.name = "sign", .emission = {1, 1, 1}}});
  const auto parts = luminous_parts(square.mesh, square.surface, 64);
  ASSERT_EQ(parts.size(), 1u);
  std::array<int, 16> cells{};
  for (const TrianglePlace& p : parts[0].points) {
    const glm::vec3 at = square.at(p);
    const auto cell = [](float v) { return std::min(3, static_cast<int>(4 * v)); };  // v may be 1
    ++cells[static_cast<std::size_t>(cell(at.x) + 4 * cell(at.z))];
  }
  EXPECT_GE(std::ranges::min(cells), 2) << "four would be even";
  EXPECT_LE(std::ranges::max(cells), 7);
}

TEST(Luminous, NothingWithoutAreaOrLight) {
  StripedSquare flat({{.name = "sign", .emission = {1, 1, 1}}});
  for (glm::vec3& p : flat.mesh.positions) p = glm::vec3(1);
  EXPECT_TRUE(luminous_parts(flat.mesh, flat.surface, 16).empty());
  const StripedSquare dark({{.name = "off", .emission = {0, 0, 0}}});
  EXPECT_TRUE(luminous_parts(dark.mesh, dark.surface, 16).empty());
}

}  // namespace
}  // namespace penumbra::prt
