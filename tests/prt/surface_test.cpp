#include <cmath>
#include <glm/geometric.hpp>

#include "prt/prt.h"
#include "tests/prt/gltf_fixture.h"
#include "tests/support/gltf_assets.h"

namespace penumbra::prt {
namespace {

class SurfaceLists : public GltfFixture {
 protected:
  // A ball with a normal map, and vertex colours that are 1 minus the coordinates.
  Import coloured_ball() const {
    test::GltfMaker maker = test::rubber_ball();
    std::vector<float> colours;
    for (const glm::vec2& uv : test::gltf_sphere(.15f, 24).coordinates)
      colours.insert(colours.end(), {1 - uv.x, 1 - uv.y, 1});
    maker.root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = maker.floats(colours, 3);
    return read(maker);
  }
};

TEST_F(SurfaceLists, ExtendFollowsWhatSubdivideAdds) {
  Import import = coloured_ball();
  SurfaceMaterials surface = *import.surface;
  Mesh mesh = import.mesh;
  const auto middles = subdivide(mesh, .01f);
  ASSERT_GT(middles.size(), 1000u);
  surface.extend(middles);
  const std::size_t n = mesh.positions.size();
  ASSERT_EQ(surface.material.size(), n);
  ASSERT_EQ(surface.coordinates[0].size(), n);
  ASSERT_EQ(surface.tangents.size(), n);
  ASSERT_EQ(surface.tint.size(), n);
  EXPECT_TRUE(surface.coordinates[1].empty()) << "what is absent stays so";
  for (std::size_t i = 0; i < n; ++i) {
    const glm::vec2& uv = surface.coordinates[0][i];
    EXPECT_NEAR(surface.tint[i].r, 1 - uv.x, 1e-5) << "linear in the middle";
    EXPECT_NEAR(surface.tint[i].g, 1 - uv.y, 1e-5);
    EXPECT_NEAR(glm::length(glm::vec3(surface.tangents[i])), 1, 1e-5);
    EXPECT_EQ(std::abs(surface.tangents[i].w), 1);
  }
  EXPECT_EQ(surface.material.back(), 0);
}

// ------------------------------------------------------------------------------------- baked files

using BakedSurface = SurfaceLists;

BakedObject baked_with_surface(Import import) {
  BakeOptions options;
  options.bands = 2;
  options.rays = 64;
  options.bounces = 1;
  auto out = bake(std::move(import.mesh), options);
  EXPECT_TRUE(out);
  out->surface = import.surface;
  return *out;
}

void expect_same_texture(const Texture& a, const Texture& b) {
  ASSERT_EQ(bool(a), bool(b));
  if (!a) return;
  EXPECT_EQ(a.picture->codes, b.picture->codes);
  EXPECT_EQ(a.picture->file, b.picture->file) << "the original bytes";
  EXPECT_EQ(a.picture->mime, b.picture->mime);
  EXPECT_EQ(a.wrap_s, b.wrap_s);
  EXPECT_EQ(a.wrap_t, b.wrap_t);
  EXPECT_EQ(a.nearest, b.nearest);
  EXPECT_EQ(a.set, b.set);
  for (int c = 0; c < 3; ++c) EXPECT_LT(glm::distance(a.transform[c], b.transform[c]), 1e-6f);
}

void expect_same_material(const Material& a, const Material& b) {
  SCOPED_TRACE(a.name);
  EXPECT_EQ(a.name, b.name);
  EXPECT_EQ(a.base_colour, b.base_colour);
  EXPECT_EQ(a.opacity, b.opacity);
  EXPECT_EQ(a.metallic, b.metallic);
  EXPECT_EQ(a.roughness, b.roughness);
  EXPECT_EQ(a.normal_scale, b.normal_scale);
  EXPECT_EQ(a.occlusion_strength, b.occlusion_strength);
  for (int c = 0; c < 3; ++c) EXPECT_FLOAT_EQ(a.emission[c], b.emission[c]);
  EXPECT_EQ(a.alpha, b.alpha);
  EXPECT_EQ(a.alpha_cutoff, b.alpha_cutoff);
  EXPECT_EQ(a.double_sided, b.double_sided);
  EXPECT_EQ(a.unlit, b.unlit);
  EXPECT_EQ(a.ior, b.ior);
  EXPECT_EQ(a.specular, b.specular);
  EXPECT_EQ(a.specular_colour, b.specular_colour);
  EXPECT_EQ(a.clearcoat, b.clearcoat);
  EXPECT_EQ(a.clearcoat_roughness, b.clearcoat_roughness);
  EXPECT_EQ(a.transmission, b.transmission);
  expect_same_texture(a.base_colour_map, b.base_colour_map);
  expect_same_texture(a.metallic_roughness_map, b.metallic_roughness_map);
  expect_same_texture(a.normal_map, b.normal_map);
  expect_same_texture(a.occlusion_map, b.occlusion_map);
  expect_same_texture(a.emission_map, b.emission_map);
}

void expect_same_surface(const SurfaceMaterials& a, const SurfaceMaterials& b) {
  ASSERT_EQ(a.materials.size(), b.materials.size());
  for (std::size_t i = 0; i < a.materials.size(); ++i)
    expect_same_material(a.materials[i], b.materials[i]);
  EXPECT_EQ(a.material, b.material);
  EXPECT_EQ(a.coordinates, b.coordinates);
  EXPECT_EQ(a.tangents, b.tangents);
  EXPECT_EQ(a.tint, b.tint);
}

// All nine assets beside each other, with one more that has every field.
test::GltfMaker everything() {
  test::GltfMaker maker;
  const auto image = [](std::uint8_t v) { return Image<Rgba8>(4, 4, {v, v, v, v}); };
  const int clamped =
      maker.texture(image(200), ".png", {{"wrapS", 33071}, {"wrapT", 33648}, {"magFilter", 9728}});
  const int plain = maker.texture(image(90));
  const nlohmann::json moved = {
      {"KHR_texture_transform",
       {{"offset", {.1, -.2}}, {"rotation", 2.5}, {"scale", {-2, .5}}, {"texCoord", 1}}}};
  const int all = maker.material(
      {{"name", "all"},
       {"pbrMetallicRoughness",
        {{"baseColorFactor", {.1, .2, .3, .4}},
         {"metallicFactor", .7},
         {"roughnessFactor", .6},
         {"baseColorTexture", {{"index", clamped}, {"extensions", moved}}},
         {"metallicRoughnessTexture", {{"index", plain}}}}},
       {"normalTexture", {{"index", plain}, {"scale", .3}}},
       {"occlusionTexture", {{"index", plain}, {"strength", .2}}},
       {"emissiveTexture", {{"index", clamped}}},
       {"emissiveFactor", {.1, .5, 1}},
       {"alphaMode", "MASK"},
       {"alphaCutoff", .3},
       {"doubleSided", true},
       {"extensions",
        {{"KHR_materials_emissive_strength", {{"emissiveStrength", 12}}},
         {"KHR_materials_unlit", nlohmann::json::object()},
         {"KHR_materials_ior", {{"ior", 1.7}}},
         {"KHR_materials_specular", {{"specularFactor", .4}, {"specularColorFactor", {1, .9, .8}}}},
         {"KHR_materials_clearcoat", {{"clearcoatFactor", .3}, {"clearcoatRoughnessFactor", .2}}},
         {"KHR_materials_transmission", {{"transmissionFactor", .1}}}}}});
  auto shape = test::gltf_box({1, 1, 1});
  nlohmann::json first = maker.primitive(shape, all);
  first["attributes"]["TEXCOORD_1"] = maker.vec2(shape.coordinates);
  first["attributes"]["COLOR_0"] = maker.floats(std::vector<float>(72, .5f), 3);
  const int dull =
      maker.material({{"name", "dull"}, {"pbrMetallicRoughness", {{"metallicFactor", 0}}}});
  maker.node({{"mesh", maker.mesh({maker.primitive(shape, dull), first})}});
  maker.node({{"mesh", 0}, {"translation", {3, 0, 0}}});
  return maker;
}

TEST_F(BakedSurface, ComesBackAsItWasWithItsMesh) {
  std::vector<test::GltfMaker> makers{everything()};
  for (const test::NamedAsset& a : test::kGltfAssets) makers.push_back(a.make());
  for (const test::GltfMaker& maker : makers) {
    const BakedObject before = baked_with_surface(read(maker));
    const auto path = folder_.path() / "baked.glb";
    ASSERT_TRUE(write_baked(path, before));
    const auto after = read_baked(path);
    ASSERT_TRUE(after) << after.error().detail;
    ASSERT_TRUE(after->surface);
    EXPECT_EQ(before.mesh.positions, after->mesh.positions);
    EXPECT_EQ(before.mesh.albedo, after->mesh.albedo);
    EXPECT_EQ(before.mesh.triangles, after->mesh.triangles);
    expect_same_surface(*before.surface, *after->surface);
  }
}

// What a viewer shows is the asset: the same reader takes the file for an ordinary one.
TEST_F(BakedSurface, AViewerSeesTheSameMaterials) {
  const Import asset = read(everything());
  const auto path = folder_.path() / "baked.glb";
  ASSERT_TRUE(write_baked(path, baked_with_surface(asset)));
  const auto seen = import_mesh(path, kPaper);
  ASSERT_TRUE(seen) << seen.error().detail;
  ASSERT_TRUE(seen->surface);
  EXPECT_EQ(seen->mesh.positions, asset.mesh.positions);
  expect_same_surface(*asset.surface, *seen->surface);
  ASSERT_EQ(seen->mesh.albedo.size(), asset.mesh.albedo.size());
  for (std::size_t i = 0; i < asset.mesh.albedo.size(); ++i)
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(seen->mesh.albedo[i][c], asset.mesh.albedo[i][c], 1e-5);
}

TEST_F(BakedSurface, WithoutOneViewersSeeNoMetal) {
  BakeOptions options;
  options.rays = 64;
  const auto ball = bake(make_sphere({0, 0, 0}, .3f, 1, {.5f, .4f, .3f}), options);
  ASSERT_TRUE(ball);
  const auto path = folder_.path() / "baked.glb";
  ASSERT_TRUE(write_baked(path, *ball));
  const auto back = read_baked(path);
  ASSERT_TRUE(back) << back.error().detail;
  EXPECT_FALSE(back->surface);
  const auto seen = import_mesh(path, kPaper);
  ASSERT_TRUE(seen) << seen.error().detail;
  EXPECT_FALSE(seen->surface) << "an albedo is all that it says";
  for (const Rgb& a : seen->mesh.albedo) EXPECT_NEAR(a.r, .5f, 1e-5);
}

TEST_F(BakedSurface, PartsThatDoNotAgreeAreErrors) {
  const auto path = folder_.path() / "baked.glb";
  const BakedObject whole = baked_with_surface(read(everything()));
  const auto error_of = [&](auto damage) {
    BakedObject o = whole;
    SurfaceMaterials s = *o.surface;
    damage(s);
    o.surface = std::make_shared<const SurfaceMaterials>(s);
    EXPECT_TRUE(write_baked(path, o));
    const auto back = read_baked(path);
    EXPECT_FALSE(back);
    return back ? ErrorCode::kClosed : back.error().code;
  };
  EXPECT_EQ(error_of([](SurfaceMaterials& s) { s.coordinates[0].pop_back(); }),
            ErrorCode::kUnreadable);
  EXPECT_EQ(error_of([](SurfaceMaterials& s) { s.tangents.pop_back(); }), ErrorCode::kUnreadable);
  EXPECT_EQ(error_of([](SurfaceMaterials& s) { s.tint[0].g = NAN; }), ErrorCode::kUnreadable);
  EXPECT_EQ(error_of([](SurfaceMaterials& s) { s.materials.pop_back(); }), ErrorCode::kUnreadable);
}

}  // namespace
}  // namespace penumbra::prt
