// Objects of metal, plastic and rubber in rooms that they mirror: the composite against the world
// in which they really stand.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "tests/support/environment_maps.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

using prt::Material, prt::Rgba8, prt::SurfaceMaterials;

// ---------------------------------------------------------------------------------- materials

std::shared_ptr<const prt::TexturePicture> picture_of(
    const std::function<glm::vec3(float u, float v)>& value) {
  constexpr int kSize = 64;
  auto out = std::make_shared<prt::TexturePicture>();
  out->codes = Image<Rgba8>(kSize, kSize);
  const auto code = [](float v) { return static_cast<std::uint8_t>(std::lround(255 * v)); };
  for (int y = 0; y < kSize; ++y)
    for (int x = 0; x < kSize; ++x) {
      const glm::vec3 c =
          value((static_cast<float>(x) + .5f) / kSize, (static_cast<float>(y) + .5f) / kSize);
      out->codes.at(x, y) = {code(c.x), code(c.y), code(c.z), 255};
    }
  return out;
}

// Tiles with dents, glazed in the middle and rough at the edge.
Material tiles() {
  const auto wave = [](float t) { return std::sin(2 * static_cast<float>(kPi) * t); };
  Material m{.name = "tiles", .metallic = 1, .roughness = 1};
  m.base_colour_map.picture = picture_of(
      [&](float u, float v) { return .6f + .25f * glm::vec3(wave(u), wave(v), wave(u + v)); });
  m.metallic_roughness_map.picture = picture_of([&](float u, float v) {
    return glm::vec3(1, .5f + .2f * wave(u) * wave(v), wave(v) > 0 ? 1.f : 0.f);
  });
  m.normal_map.picture = picture_of([&](float u, float v) {
    const glm::vec3 n = glm::normalize(glm::vec3(.25f * wave(u), .25f * wave(v), 1));
    return .5f + .5f * n;
  });
  return m;
}

const Rgb kSteel{.55f, .56f, .55f};

struct Surface {
  const char* name;
  Material material;
};
const std::vector<Surface>& surfaces() {
  static const std::vector<Surface> all = {
      {"gold", {.base_colour = {1, .77f, .34f}, .metallic = 1, .roughness = .25f}},
      {"chrome", {.base_colour = kSteel, .metallic = 1, .roughness = .05f}},
      {"brushed", {.base_colour = kSteel, .metallic = 1, .roughness = .5f}},
      {"plastic", {.base_colour = {.5f, .1f, .1f}, .metallic = 0, .roughness = .3f}},
      {"rubber", {.base_colour = {.2f, .2f, .2f}, .metallic = 0, .roughness = .9f}},
      {"tiles", tiles()}};
  return all;
}

std::shared_ptr<const SurfaceMaterials> surface_of(const prt::Mesh& mesh,
                                                   const Material& material) {
  SurfaceMaterials out;
  out.materials = {material};
  out.material.assign(mesh.positions.size(), 0);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const glm::vec3 along = glm::cross(glm::vec3(0, 1, 0), mesh.normals[i]), p = mesh.positions[i];
    out.tangents.emplace_back(
        glm::length(along) > 1e-4f ? glm::normalize(along) : glm::vec3(1, 0, 0), 1.f);
    out.coordinates[0].emplace_back(8 * (p.x + .5f * p.z), 8 * (.5f * p.z - p.y));
  }
  return std::make_shared<const SurfaceMaterials>(std::move(out));
}

// ---------------------------------------------------------------------------------- worlds

// What a bake sees of a material: its base colour.
Rgb baked_albedo(const Material& m) {
  return m.base_colour_map ? kSteel : m.base_colour;  // near the mean of the tiles' picture
}

const Rgb kFloor{.4f, .4f, .4f};

Result<PreparedScene> scene_of(const std::string& shape, const Material& material) {
  SceneObject o = test::twist({0, 0, 0});
  o.asset = "builtin:" + shape;
  o.name = shape;
  o.albedo = baked_albedo(material);
  o.coarse = true;  // seconds, and what is missing is not the bake's
  PENUMBRA_ASSIGN(scene, test::prepared({{o}, {test::grey_plane()}}));
  scene.objects[0].baked.surface = surface_of(scene.objects[0].baked.mesh, material);
  return scene;
}

lighting::LightEstimate light_of(const Image<Rgb>& map, const PreparedScene& scene) {
  lighting::LightEstimator estimator({5, {}});
  estimator.mirror(mirrored_roughness(scene));
  Environment environment;
  environment.radiance = map;
  const auto light = estimator.estimate(environment);
  EXPECT_TRUE(light);
  return light ? *light : lighting::LightEstimate{};
}

struct Bar {
  const char* material;
  double object, shadow;
};
struct GlossyCase {
  const char *shape, *map;
  std::vector<Bar> bars;
};
void PrintTo(const GlossyCase& c, std::ostream* out) {
  *out << c.shape << ' ' << c.map;
}

class GlossyGroundTruth : public testing::TestWithParam<GlossyCase> {};

TEST_P(GlossyGroundTruth, ObjectFollowsTheWorldThatItMirrors) {
  const GlossyCase& c = GetParam();
  PENUMBRA_NEED_ENVIRONMENT(read, c.map);
  const Image<Rgb> map = with_floor_below(read, {prt::Plane{{0, 0, 0}, {0, 1, 0}, kFloor, {}}});
  const prt::PinholeView view{
      96, 72, {105, 105}, {48, 36}, capture::look_at({.25, .95, 1.35}, {0, .17, 0})};
  std::optional<Masks> masks;
  for (const Bar& bar : c.bars) {
    const Material& material =
        std::ranges::find(surfaces(), std::string_view(bar.material), &Surface::name)->material;
    const auto scene = scene_of(c.shape, material);
    ASSERT_TRUE(scene) << scene.error().detail;
    const lighting::LightEstimate light = light_of(map, *scene);
    lighting::LightEstimate harmonics = light;  // which are mirrored alone then
    harmonics.reflections.reset();
    if (!masks) {
      auto made = make_masks(*scene, view);
      if (!made && made.error().code == ErrorCode::kUnavailable)
        GTEST_SKIP() << "no OpenGL ES 3.1 here: " << made.error().detail;
      ASSERT_TRUE(made) << made.error().detail;
      masks = std::move(*made);
    }
    const StillScene in{&*scene, &map, view};
    const auto empty = render_real(in, .02, {});
    const auto truth = render_reference(in, true, .025, std::nullopt, {});
    ASSERT_TRUE(empty && truth);
    const auto ours = render_composite(in, light, *empty);
    const auto blurred = render_composite(in, harmonics, *empty);
    ASSERT_TRUE(ours && blurred);
    const Accuracy a = compare_pictures(*ours, *truth, *empty, *masks),
                   naive = compare_pictures(*blurred, *truth, *empty, *masks);
    std::printf(
        "%-4s %-15s %-8s object %.1f %% (mirrors harmonics %.1f %%), bias %+.1f %%, shadow %.4f\n",
        c.shape, c.map, bar.material, 100 * a.object_without_noise,
        100 * naive.object_without_noise, 100 * a.object_bias, a.shadow_rmse);
    EXPECT_LT(a.object_without_noise, bar.object) << bar.material;
    EXPECT_LT(a.shadow_rmse, bar.shadow) << bar.material;
    EXPECT_LT(std::abs(a.object_bias), .15) << bar.material;
    EXPECT_LT(a.object_without_noise, naive.object_without_noise) << bar.material;
  }
}

// A little above what they come to; the goal is .06. What is missing, by terms that are switched
// off in the reference, for gold:
// - A knot mirrors itself: 82 % off if it did not, 35 % if what it sees of itself is lit as it is.
// - Seen slantwise a lobe is longer than wide, and not quite as five lobes in a row are: most of
//   what a studio's lamps are off by.
// - What a metal sends to the floor is mirrored, not scattered: a box before a window.
const GlossyCase kGlossyCases[] = {
    {"ball",
     "room",
     {{"gold", .04, .04},
      {"chrome", .02, .04},
      {"brushed", .075, .035},
      {"plastic", .02, .035},
      {"rubber", .02, .035},
      {"tiles", .075, .035}}},
    {"knot",
     "room",
     {{"gold", .1, .04},
      {"chrome", .15, .04},
      {"brushed", .105, .035},
      {"plastic", .04, .035},
      {"rubber", .044, .035},
      {"tiles", .095, .035}}},
    {"box", "room", {{"gold", .055, .13}, {"plastic", .035, .04}}},
    {"ball", "studio_small_03", {{"gold", .12, .04}, {"plastic", .01, .03}}},
    {"ball", "venice_sunset", {{"gold", .025, .04}, {"plastic", .06, .03}}},
    {"ball",
     "immenstadter_horn",
     {{"gold", .115, .03}, {"brushed", .07, .03}, {"plastic", .04, .04}}},
};
INSTANTIATE_TEST_SUITE_P(Worlds, GlossyGroundTruth, testing::ValuesIn(kGlossyCases),
                         [](const auto& c) {
                           return std::string(c.param.shape) + "_" + c.param.map;
                         });

}  // namespace
}  // namespace penumbra::tools
