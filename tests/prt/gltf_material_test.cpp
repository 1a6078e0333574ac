#include <cmath>
#include <glm/geometric.hpp>
#include <set>

#include "tests/prt/gltf_fixture.h"
#include "tests/support/gltf_assets.h"

namespace penumbra::prt {
namespace {

using nlohmann::json;
using test::GltfMaker;

class GltfMaterial : public GltfFixture {
 protected:
  // A card of this material, which must give a surface. The material may add pictures to the maker
  // that it goes with: so that is not copied while arguments are found.
  Import card(const GltfMaker& with_pictures, const json& material) const {
    GltfMaker maker = with_pictures;
    maker.place(test::gltf_card(1, 1), maker.material(material));
    Import out = read(maker);
    EXPECT_TRUE(out.surface);
    return out;
  }
  static const Material& only(const Import& import) {
    EXPECT_TRUE(import.surface && import.surface->materials.size() == 1);
    return import.surface->materials.at(0);
  }
};

void expect_near(const Rgb& a, const Rgb& b, float tolerance = 1e-5f) {
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(a[c], b[c], tolerance) << c;
}

float linear_of(int code) {  // IEC 61966-2-1
  const float v = static_cast<float>(code) / 255;
  return v <= .04045f ? v / 12.92f : std::pow((v + .055f) / 1.055f, 2.4f);
}

TEST_F(GltfMaterial, WithoutMoreThanAnAlbedoThereIsNoSurface) {
  GltfMaker none, plain;
  none.place(test::gltf_card(1, 1));
  plain.place(test::gltf_card(1, 1),
              plain.material({{"pbrMetallicRoughness",
                               {{"baseColorFactor", {.2, .4, .6, 1}}, {"metallicFactor", 0}}}}));
  const Import a = read(none), b = read(plain);
  EXPECT_FALSE(a.surface);
  EXPECT_FALSE(b.surface);
  expect_near(a.mesh.albedo[0], kPaper);
  expect_near(b.mesh.albedo[0], {.2f, .4f, .6f});
}

TEST_F(GltfMaterial, FactorsComeAsTheFileHasThem) {
  GltfMaker maker;
  for (const char* e :
       {"KHR_materials_emissive_strength", "KHR_materials_unlit", "KHR_materials_ior",
        "KHR_materials_specular", "KHR_materials_clearcoat", "KHR_materials_transmission"})
    maker.use(e, true);
  const json extensions = {
      {"KHR_materials_emissive_strength", {{"emissiveStrength", 10}}},
      {"KHR_materials_unlit", json::object()},
      {"KHR_materials_ior", {{"ior", 1.33}}},
      {"KHR_materials_specular", {{"specularFactor", .5}, {"specularColorFactor", {1, .5, .25}}}},
      {"KHR_materials_clearcoat", {{"clearcoatFactor", .75}, {"clearcoatRoughnessFactor", .125}}},
      {"KHR_materials_transmission", {{"transmissionFactor", .5}}}};
  const Import import = card(maker, {{"name", "all"},
                                     {"pbrMetallicRoughness",
                                      {{"baseColorFactor", {.5, .25, .125, .75}},
                                       {"metallicFactor", .25},
                                       {"roughnessFactor", .5}}},
                                     {"emissiveFactor", {.5, .25, 0}},
                                     {"alphaMode", "BLEND"},
                                     {"doubleSided", true},
                                     {"extensions", extensions}});
  const Material& m = only(import);
  EXPECT_EQ(m.name, "all");
  EXPECT_EQ(m.base_colour, (Rgb{.5f, .25f, .125f}));
  EXPECT_EQ(m.opacity, .75f);
  EXPECT_EQ(m.metallic, .25f);
  EXPECT_EQ(m.roughness, .5f);
  EXPECT_EQ(m.emission, (Rgb{5, 2.5f, 0}));
  EXPECT_EQ(m.alpha, Material::Alpha::kBlend);
  EXPECT_TRUE(m.double_sided);
  EXPECT_TRUE(m.unlit);
  EXPECT_FLOAT_EQ(m.ior, 1.33f);
  EXPECT_EQ(m.specular, .5f);
  EXPECT_EQ(m.specular_colour, (Rgb{1, .5f, .25f}));
  EXPECT_EQ(m.clearcoat, .75f);
  EXPECT_EQ(m.clearcoat_roughness, .125f);
  EXPECT_EQ(m.transmission, .5f);
  EXPECT_TRUE(says(import, "transmission"));
}

TEST_F(GltfMaterial, DefaultsAreThoseOfTheSpecification) {
  const Import import = card({}, json::object());
  const Material& m = only(import);
  EXPECT_EQ(m.metallic, 1);
  EXPECT_EQ(m.roughness, 1);
  EXPECT_EQ(m.base_colour, (Rgb{1, 1, 1}));
  EXPECT_EQ(m.alpha, Material::Alpha::kOpaque);
  EXPECT_EQ(m.ior, 1.5f);
}

TEST_F(GltfMaterial, MapsComeWithTheirSamplersAndSets) {
  GltfMaker maker;
  const int first = maker.texture(picture(4, 2, {255, 0, 0, 255}), ".png",
                                  {{"wrapS", 33071}, {"wrapT", 33648}, {"magFilter", 9728}});
  const int second = maker.texture(picture(2, 8, {0, 255, 0, 128}));
  auto shape = test::gltf_card(1, 1);
  json primitive = maker.primitive(shape);
  for (glm::vec2& uv : shape.coordinates) uv *= 3;
  primitive["attributes"]["TEXCOORD_1"] = maker.vec2(shape.coordinates);
  primitive["material"] =
      maker.material({{"pbrMetallicRoughness",
                       {{"baseColorTexture", {{"index", first}}},
                        {"metallicRoughnessTexture", {{"index", second}, {"texCoord", 1}}}}},
                      {"normalTexture", {{"index", first}, {"scale", .5}}},
                      {"occlusionTexture", {{"index", second}, {"strength", .25}}},
                      {"emissiveTexture", {{"index", second}}}});
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  const Import import = read(maker);
  const Material& m = only(import);
  EXPECT_EQ(m.base_colour_map.wrap_s, Texture::Wrap::kClamp);
  EXPECT_EQ(m.base_colour_map.wrap_t, Texture::Wrap::kMirror);
  EXPECT_TRUE(m.base_colour_map.nearest);
  EXPECT_EQ(m.base_colour_map.picture, m.normal_map.picture) << "a picture is held once";
  EXPECT_EQ(m.base_colour_map.picture->codes.width(), 4);
  EXPECT_EQ(m.base_colour_map.picture->mime, "image/png");
  EXPECT_EQ(m.metallic_roughness_map.set, 1);
  EXPECT_EQ(m.metallic_roughness_map.wrap_s, Texture::Wrap::kRepeat);
  EXPECT_EQ(m.metallic_roughness_map.picture->codes.at(0, 0), (Rgba8{0, 255, 0, 128}));
  EXPECT_EQ(m.normal_scale, .5f);
  EXPECT_EQ(m.occlusion_strength, .25f);
  const SurfaceMaterials& s = *import.surface;
  ASSERT_EQ(s.coordinates[0].size(), import.mesh.positions.size());
  ASSERT_EQ(s.coordinates[1].size(), import.mesh.positions.size());
  for (std::size_t i = 0; i < s.coordinates[0].size(); ++i)
    EXPECT_EQ(s.coordinates[1][i], 3.f * s.coordinates[0][i]);
}

TEST_F(GltfMaterial, CoordinatesThatNoMapAsksForAreNotKept) {
  const Import import = card({}, {{"pbrMetallicRoughness", {{"metallicFactor", 1}}}});
  EXPECT_TRUE(import.surface->coordinates[0].empty());
  EXPECT_TRUE(import.surface->coordinates[1].empty());
  EXPECT_TRUE(import.surface->tangents.empty());
  EXPECT_TRUE(import.surface->tint.empty());
}

// The example of the extension's text: the lower left quadrant, turned clockwise by a quarter.
TEST_F(GltfMaterial, TextureTransformScalesThenTurnsThenMoves) {
  GltfMaker maker;
  maker.use("KHR_texture_transform", true);
  const json transform = {{"offset", {0, 1}}, {"rotation", 1.57079632679}, {"scale", {.5, .5}}};
  const Import import = card(maker, {{"emissiveFactor", {1, 1, 1}},
                                     {"emissiveTexture",
                                      {{"index", maker.texture(picture(2, 2, {1, 2, 3, 255}))},
                                       {"extensions", {{"KHR_texture_transform", transform}}}}}});
  const glm::mat3x2& t = only(import).emission_map.transform;
  EXPECT_LT(glm::distance(t * glm::vec3(0, 0, 1), glm::vec2(0, 1)), 1e-6f);
  EXPECT_LT(glm::distance(t * glm::vec3(1, 0, 1), glm::vec2(0, .5f)), 1e-6f);
  EXPECT_LT(glm::distance(t * glm::vec3(0, 1, 1), glm::vec2(.5f, 1)), 1e-6f);
}

TEST_F(GltfMaterial, TextureTransformMayChooseTheSet) {
  GltfMaker maker;
  maker.use("KHR_texture_transform");
  const Import import =
      card(maker, {{"pbrMetallicRoughness",
                    {{"baseColorTexture",
                      {{"index", maker.texture(picture(2, 2, {1, 2, 3, 255}))},
                       {"extensions", {{"KHR_texture_transform", {{"texCoord", 1}}}}}}}}}});
  EXPECT_EQ(only(import).base_colour_map.set, 1);
}

// ------------------------------------------------------------------------------------- albedo

TEST_F(GltfMaterial, AlbedoIsFactorTimesVertexColourTimesPictureOfMetalToo) {
  GltfMaker maker;
  json primitive = maker.primitive(test::gltf_card(1, 1));
  const std::uint8_t half[] = {128, 255, 0, 255, 128, 255, 0, 255,
                               128, 255, 0, 255, 128, 255, 0, 255};
  primitive["attributes"]["COLOR_0"] =
      maker.accessor(half, sizeof(half), 5121, 4, 4, {{"normalized", true}});
  primitive["material"] = maker.material(
      {{"pbrMetallicRoughness",
        {{"baseColorFactor", {.5, .5, 1, 1}},
         {"metallicFactor", .5},
         {"baseColorTexture", {{"index", maker.texture(picture(8, 8, {188, 188, 188, 255}))}}},
         {"metallicRoughnessTexture",
          {{"index", maker.texture(picture(8, 8, {0, 0, 51, 255}))}}}}}});
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  const Import import = read(maker);
  const float texel = linear_of(188);
  for (const Rgb& a : import.mesh.albedo) expect_near(a, {.5f * 128 / 255 * texel, .5f * texel, 0});
  // What is drawn keeps its parts.
  EXPECT_EQ(only(import).base_colour, (Rgb{.5f, .5f, 1}));
  ASSERT_EQ(import.surface->tint.size(), import.mesh.positions.size());
  expect_near(import.surface->tint[0], {128.f / 255, 1, 0});
}

TEST_F(GltfMaterial, VertexColoursOfAnyTypeAreTheSame) {
  const auto albedo = [&](auto put) {
    GltfMaker maker;
    json primitive = maker.primitive(test::gltf_card(1, 1));
    primitive["attributes"]["COLOR_0"] = put(maker);
    maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
    const Import import = read(maker);
    EXPECT_FALSE(import.surface) << "colours alone are an albedo";
    return import.mesh.albedo.at(0);
  };
  const std::uint8_t bytes[] = {51, 102, 204, 0, 51, 102, 204, 0, 51, 102, 204, 0, 51, 102, 204, 0};
  std::uint16_t shorts[16];
  std::vector<float> floats;
  for (std::size_t i = 0; i < 16; ++i) {
    shorts[i] = static_cast<std::uint16_t>(bytes[i] * 257);
    if (i % 4 != 3) floats.push_back(static_cast<float>(bytes[i]) / 255);
  }
  const json normalised = {{"normalized", true}};
  const Rgb expected = kPaper * Rgb{.2f, .4f, .8f};
  expect_near(albedo([&](GltfMaker& m) { return m.floats(floats, 3); }), expected);
  expect_near(albedo([&](GltfMaker& m) { return m.accessor(bytes, 16, 5121, 4, 4, normalised); }),
              expected);
  expect_near(albedo([&](GltfMaker& m) { return m.accessor(shorts, 32, 5123, 4, 4, normalised); }),
              expected);
}

TEST_F(GltfMaterial, MaskedAwayTexelsColourNoAlbedo) {
  Image<Rgba8> half(16, 16, {0, 0, 0, 0});  // black where it is not seen
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 16; x += 2) half.at(x, y) = {255, 255, 255, 255};
  for (const bool masked : {false, true}) {
    GltfMaker maker;
    json material = {
        {"pbrMetallicRoughness",
         {{"metallicFactor", 0}, {"baseColorTexture", {{"index", maker.texture(half)}}}}}};
    if (masked) material["alphaMode"] = "MASK";
    const Import import = card(maker, material);
    EXPECT_EQ(import.mesh.triangles.size(), 2u) << "holes are the renderer's";
    expect_near(import.mesh.albedo[0], masked ? Rgb{1, 1, 1} : Rgb{.5f, .5f, .5f});
  }
}

TEST_F(GltfMaterial, AlbedoFollowsThePictureAroundEachVertex) {
  Image<Rgba8> halves(64, 64, {255, 255, 255, 255});
  for (int y = 0; y < 64; ++y)
    for (int x = 32; x < 64; ++x) halves.at(x, y) = {0, 0, 0, 255};
  GltfMaker maker;
  json pbr = {{"metallicFactor", 0}, {"baseColorTexture", {{"index", maker.texture(halves)}}}};
  maker.place(test::gltf_sphere(1, 16), maker.material({{"pbrMetallicRoughness", pbr}}));
  const Import import = read(maker);
  for (std::size_t i = 0; i < import.mesh.positions.size(); ++i) {
    const float u = import.surface->coordinates[0][i].x;
    if (u > .1f && u < .4f) expect_near(import.mesh.albedo[i], {1, 1, 1});
    if (u > .6f && u < .9f) expect_near(import.mesh.albedo[i], {0, 0, 0});
  }
}

// ------------------------------------------------------------------------------------- tangents

TEST_F(GltfMaterial, MadeTangentsPointAlongThePicturesRow) {
  GltfMaker maker;
  const Import import = card(
      maker, {{"normalTexture", {{"index", maker.texture(picture(2, 2, {128, 128, 255, 255}))}}}});
  ASSERT_EQ(import.surface->tangents.size(), 4u);
  for (const glm::vec4& t : import.surface->tangents)
    EXPECT_LT(glm::distance(t, glm::vec4(1, 0, 0, 1)), 1e-5f);
}

// cross(normal, tangent) * w points up in the picture, so mirroring turns w.
TEST_F(GltfMaterial, TheBitangentPointsUpInThePictureWhateverTheNode) {
  for (const glm::vec3 scale : {glm::vec3(1, 1, 1), {-1, 1, 1}, {1, -1, 1}, {2, 3, -.5f}})
    for (const bool given : {false, true}) {
      GltfMaker maker;
      json primitive = maker.primitive(test::gltf_card(1, 1));
      if (given)
        primitive["attributes"]["TANGENT"] =
            maker.floats({1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1}, 4);
      primitive["material"] = maker.material(
          {{"normalTexture", {{"index", maker.texture(picture(2, 2, {128, 128, 255, 255}))}}}});
      maker.node(
          {{"mesh", maker.mesh(json::array({primitive}))}, {"scale", {scale.x, scale.y, scale.z}}});
      const Import import = read(maker);
      const glm::vec3 row(scale.x > 0 ? 1 : -1, 0, 0), up(0, scale.y > 0 ? 1 : -1, 0);
      for (std::size_t i = 0; i < import.mesh.positions.size(); ++i) {
        const glm::vec4& t = import.surface->tangents[i];
        const glm::vec3 bitangent = glm::cross(import.mesh.normals[i], glm::vec3(t)) * t.w;
        EXPECT_LT(glm::distance(glm::vec3(t), row), 1e-5f)
            << given << scale.x << scale.y << scale.z;
        EXPECT_LT(glm::distance(bitangent, up), 1e-5f) << given << scale.x << scale.y << scale.z;
      }
    }
}

TEST_F(GltfMaterial, TangentsAreUnitAndPerpendicularAndTurnWhereThePictureIsMirrored) {
  auto shape = test::gltf_sphere(1, 16);
  for (glm::vec2& uv : shape.coordinates) uv.x = std::abs(2 * uv.x - 1);
  GltfMaker maker;
  maker.place(shape,
              maker.material({{"normalTexture",
                               {{"index", maker.texture(picture(2, 2, {128, 128, 255, 255}))}}}}));
  const Import import = read(maker);
  std::set<float> ways;
  for (std::size_t i = 0; i < import.mesh.positions.size(); ++i) {
    const glm::vec4& t = import.surface->tangents[i];
    ASSERT_NEAR(glm::length(glm::vec3(t)), 1, 1e-5);
    ASSERT_NEAR(glm::dot(glm::vec3(t), import.mesh.normals[i]), 0, 1e-5);
    ways.insert(t.w);
  }
  EXPECT_EQ(ways, (std::set<float>{-1, 1}));
  for (const auto& t : import.mesh.triangles)
    EXPECT_EQ(import.surface->tangents[t[0]].w, import.surface->tangents[t[1]].w)
        << "a triangle shows its picture one way round";
}

// ------------------------------------------------------------------------------------- several

TEST_F(GltfMaterial, EachTriangleHasTheMaterialOfItsPrimitive) {
  GltfMaker maker;
  const auto metal = [&](double roughness, const char* name) {
    return maker.material(
        {{"name", name}, {"pbrMetallicRoughness", {{"roughnessFactor", roughness}}}});
  };
  const int unused = metal(.9, "unused"), smooth = metal(.1, "smooth"), rough = metal(.8, "rough");
  EXPECT_EQ(unused, 0);
  const auto box = test::gltf_box({1, 1, 1});
  maker.node({{"mesh", maker.mesh({maker.primitive(box, rough), maker.primitive(box, smooth)})}});
  maker.node(
      {{"mesh", maker.mesh(json::array({maker.primitive(box)}))}, {"translation", {5, 0, 0}}});
  maker.node({{"mesh", 0}, {"translation", {9, 0, 0}}});
  const Import import = read(maker);
  const SurfaceMaterials& s = *import.surface;
  ASSERT_EQ(s.materials.size(), 3u) << "those in use";
  EXPECT_EQ(s.materials[0].name, "rough");
  EXPECT_EQ(s.materials[1].name, "smooth");
  EXPECT_EQ(s.materials[2].base_colour, kPaper) << "what has none gets the default albedo";
  EXPECT_EQ(s.materials[2].metallic, 0);
  std::vector<int> triangles(3);
  for (std::size_t i = 0; i < import.mesh.triangles.size(); ++i) {
    const auto& t = import.mesh.triangles[i];
    EXPECT_TRUE(s.material[t[0]] == s.material[t[1]] && s.material[t[0]] == s.material[t[2]]);
    ++triangles[s.material[t[0]]];
    const auto& before = import.mesh.triangles[i == 0 ? 0 : i - 1];
    EXPECT_GE(s.material[t[0]], s.material[before[0]]) << "in order";
  }
  EXPECT_EQ(triangles, (std::vector<int>{24, 24, 12}));
}

TEST_F(GltfMaterial, SpecularGlossinessIsApproximatedAndSaid) {
  GltfMaker maker;
  maker.use("KHR_materials_pbrSpecularGlossiness");
  const Import import =
      card(maker, {{"name", "old"},
                   {"extensions",
                    {{"KHR_materials_pbrSpecularGlossiness",
                      {{"diffuseFactor", {.5, .25, .125, 1}}, {"glossinessFactor", .75}}}}}});
  EXPECT_EQ(only(import).metallic, 0);
  EXPECT_EQ(only(import).roughness, .25f);
  expect_near(import.mesh.albedo[0], {.5f, .25f, .125f});
  EXPECT_TRUE(says(import, "\"old\"): specular-glossiness"));
}

TEST_F(GltfMaterial, MapsThatAreNotReadAreSaidByName) {
  GltfMaker maker;
  maker.use("KHR_materials_clearcoat");
  const int texture = maker.texture(picture(2, 2, {255, 255, 255, 255}));
  const Import import = card(
      maker, {{"name", "car"},
              {"occlusionTexture", {{"index", texture}, {"texCoord", 2}}},
              {"extensions",
               {{"KHR_materials_clearcoat",
                 {{"clearcoatFactor", 1}, {"clearcoatNormalTexture", {{"index", texture}}}}}}}});
  EXPECT_TRUE(says(import, "(\"car\"): its clearcoatNormalTexture"));
  EXPECT_TRUE(says(import, "(\"car\"): its occlusionTexture"));
  EXPECT_FALSE(only(import).occlusion_map);
}

TEST_F(GltfMaterial, TheNineAssetsAreWhatTheirNamesSay) {
  std::map<std::string, Import> assets;
  for (const test::NamedAsset& a : test::kGltfAssets) {
    SCOPED_TRACE(a.name);
    Import import = read(a.make());
    ASSERT_TRUE(import.surface);
    EXPECT_TRUE(import.left_out.empty());
    const Bounds b = bounds_of(import.mesh);
    EXPECT_NEAR(b.low.y, 0, 1e-5);
    EXPECT_NEAR(b.high.y, .3f, .051f);
    for (const auto* map : {&only(import).base_colour_map, &only(import).metallic_roughness_map,
                            &only(import).normal_map, &only(import).emission_map})
      EXPECT_EQ(*map ? map->picture->codes.width() : 256, 256);
    assets[a.name] = std::move(import);
  }
  for (const char* metal : {"gold", "chrome", "brushed_metal"}) {
    EXPECT_EQ(only(assets[metal]).metallic, 1);
    expect_near(assets[metal].mesh.albedo[0], only(assets[metal]).base_colour);
  }
  EXPECT_GT(assets["plastic"].mesh.albedo[0].r, .5f);
  EXPECT_EQ(only(assets["plastic"]).clearcoat, 1);
  EXPECT_EQ(assets["rubber"].surface->tangents.size(), assets["rubber"].mesh.positions.size());
  EXPECT_EQ(only(assets["wood"]).base_colour_map.picture->mime, "image/jpeg");
  EXPECT_EQ(only(assets["leaf"]).alpha, Material::Alpha::kMask);
  EXPECT_EQ(only(assets["leaf"]).base_colour_map.picture->codes.at(0, 0).a, 0);
  EXPECT_EQ(only(assets["glass"]).opacity, .2f);
  EXPECT_EQ(only(assets["sign"]).emission, (Rgb{8, 8, 8}));
}

}  // namespace
}  // namespace penumbra::prt
