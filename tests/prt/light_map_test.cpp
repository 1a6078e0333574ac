
#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>
#include <set>

#include "prt/prt.h"
#include "tests/support/characters.h"

namespace penumbra::prt {
namespace {

constexpr Rgb kHalfGrey{.5f, .5f, .5f};

// Every texel that a bilinear lookup at a random surface point reads stands for the surface near
// it.
void expect_lookups_are_covered(const Character& c, int width, int height) {
  const SurfaceLayout layout = lay_out(c, width, height);
  Mesh mesh;
  deform(c, rest_pose(c), mesh);
  const float radius = radius_around(mesh, bounds_of(mesh).centre());
  std::vector<std::int64_t> point(static_cast<std::size_t>(width * height), -1);
  for (std::size_t i = 0; i < layout.texels.size(); ++i)
    point[static_cast<std::size_t>(layout.texels[i].y * width + layout.texels[i].x)] =
        static_cast<std::int64_t>(i);
  const auto& uv = c.light_coordinates.empty() ? c.texture_coordinates : c.light_coordinates;
  std::mt19937 random(7);
  std::uniform_real_distribution<float> unit(0, 1);
  std::size_t missing = 0, looked = 0;
  for (int k = 0; k < 20000; ++k) {
    const auto& t = c.triangles[random() % c.triangles.size()];
    float a = unit(random), b = unit(random);
    if (a + b > 1) a = 1 - a, b = 1 - b;
    const glm::vec2 at = (1 - a - b) * uv[t[0]] + a * uv[t[1]] + b * uv[t[2]];
    const float x = at.x * static_cast<float>(width) - .5f,
                y = at.y * static_cast<float>(height) - .5f;
    for (int dy = 0; dy < 2; ++dy)
      for (int dx = 0; dx < 2; ++dx) {
        const int i = static_cast<int>(std::floor(x)) + dx,
                  j = static_cast<int>(std::floor(y)) + dy;
        if (i < 0 || j < 0 || i >= width || j >= height) continue;
        ++looked;
        missing += point[static_cast<std::size_t>(j * width + i)] < 0;
      }
  }
  EXPECT_EQ(missing, 0u) << "of " << looked;
  add_texels(c, layout, mesh);
  for (std::size_t i = 0; i < layout.texels.size(); ++i) {
    const glm::vec3& p = mesh.positions[layout.vertices + i];
    EXPECT_TRUE(std::isfinite(p.x + p.y + p.z));
    EXPECT_NEAR(glm::length(mesh.normals[layout.vertices + i]), 1, 1e-4f);
    EXPECT_LT(glm::distance(p, bounds_of(mesh).centre()), 1.2f * radius);
  }
}

TEST(LightMap, EveryLookupTouchesBakedTexels) {
  expect_lookups_are_covered(make_walker(kHalfGrey), 128, 128);
}

TEST(LightMap, AnAtlasServesWhatHasNoTextureCoordinates) {
  const Character knot = test::resting(make_knot(.5f, 60, 12, kHalfGrey));
  EXPECT_FALSE(texture_use(knot, 128, 128).usable());
  const Character with = for_light_map(knot, 128, 128);
  EXPECT_TRUE(texture_use(with, 128, 128).usable());
  EXPECT_EQ(with.triangles.size(), knot.triangles.size());
  for (std::size_t i = 0; i < knot.triangles.size(); ++i)
    for (std::size_t k = 0; k < 3; ++k)
      EXPECT_EQ(with.positions[with.triangles[i][k]], knot.positions[knot.triangles[i][k]]);
  expect_lookups_are_covered(with, 128, 128);
}

TEST(LightMap, OverlappingCoordinatesAreNotUsedForLight) {
  Character c = make_walker(kHalfGrey);
  EXPECT_TRUE(texture_use(c, 128, 128).usable());
  // Mirrored halves share texels, as game assets do: right for albedo, wrong for light.
  for (glm::vec2& uv : c.texture_coordinates)
    if (uv.x > .5f) uv.x = 1 - uv.x;
  const TextureUse use = texture_use(c, 128, 128);
  EXPECT_GT(use.overlap, .05);
  EXPECT_FALSE(use.usable());
  const Character with = for_light_map(c, 128, 128);
  EXPECT_TRUE(texture_use(with, 128, 128).usable());
  EXPECT_EQ(with.texture_coordinates.size(), with.positions.size());  // albedo keeps its own
  for (glm::vec2& uv : c.texture_coordinates) uv.x += .6f;
  EXPECT_GT(texture_use(c, 128, 128).outside, 0);
}

TEST(LightMap, TrianglesWithoutAreaInTheTextureAreNotLost) {
  Character c = make_walker(kHalfGrey);
  // The head's field shrunk to a point: its light would be one texel's.
  for (glm::vec2& uv : c.texture_coordinates)
    if (uv.x > .52f && uv.y < .31f) uv = {.6f, .1f};
  EXPECT_GT(texture_use(c, 128, 128).no_area, .01);
  expect_lookups_are_covered(for_light_map(c, 128, 128), 128, 128);
}

TEST(LightMap, ACoarseSphereDoesNotShadeItself) {
  // Smooth normals on flat triangles: points of the flats see their neighbours above their own
  // horizon.
  const Mesh sphere = make_sphere({0, 0, 0}, 1, 1, kHalfGrey);
  const Character c = for_light_map(test::resting(sphere), 96, 96);
  const SurfaceLayout layout = lay_out(c, 96, 96);
  Mesh mesh;
  deform(c, rest_pose(c), mesh);
  const std::size_t vertices = mesh.positions.size();
  Mesh naive = mesh;
  add_texels(c, layout, mesh);
  BakeOptions options;
  options.bands = 3;
  options.rays = 256;
  options.bounces = 0;
  const auto rms_blocked = [&](const Mesh& baked) {
    const auto object = bake(baked, options);
    double sum = 0;
    for (std::size_t p = vertices; p < baked.positions.size(); ++p)
      sum += std::pow(1 - object->transfer.value(0, 0, p) / .2820948, 2);
    return std::sqrt(sum / static_cast<double>(layout.texels.size()));
  };
  const double ours = rms_blocked(mesh);
  // Without the lift the same points lie on the flats.
  naive.positions.resize(mesh.positions.size());
  naive.normals = mesh.normals;
  naive.albedo = mesh.albedo;
  for (std::size_t i = 0; i < layout.texels.size(); ++i) {
    const auto& texel = layout.texels[i];
    const auto& t = c.triangles[texel.triangle];
    naive.positions[vertices + i] = (1 - texel.u - texel.v) * naive.positions[t[0]] +
                                    texel.u * naive.positions[t[1]] +
                                    texel.v * naive.positions[t[2]];
  }
  EXPECT_GT(rms_blocked(naive), .005);
  EXPECT_LT(ours, .001);
}

TEST(LightMap, NeighboursComeEarlierAndShareTheBone) {
  const SurfaceLayout layout = lay_out(make_walker(kHalfGrey), 64, 64);
  for (std::size_t p = 0; p < layout.points(); ++p)
    for (const std::uint32_t n : layout.neighbours[p]) {
      if (n == SurfaceLayout::kNone) continue;
      EXPECT_LT(n, p);
      EXPECT_EQ(layout.bone[n], layout.bone[p]);
    }
}

}  // namespace
}  // namespace penumbra::prt
