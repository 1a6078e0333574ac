#include <cstring>
#include <fstream>
#include <limits>
#include <utility>

#include "tests/fuzz/mutate.h"
#include "tests/prt/gltf_fixture.h"
#include "tests/support/gltf_assets.h"

namespace penumbra::prt {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using test::GltfMaker;

class GltfFiles : public GltfFixture {
 protected:
  static bool has(const std::string& text, std::string_view part) {
    return text.find(part) != std::string::npos;
  }
  // A card with a picture that lies at `uri`.
  static GltfMaker card_with_picture(const std::string& uri) {
    GltfMaker maker;
    maker.add("images", {{"uri", uri}});
    maker.add("textures", {{"source", 0}});
    maker.place(test::gltf_card(1, 1),
                maker.material({{"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 0}}}}}}));
    return maker;
  }
  static GltfMaker card() {
    GltfMaker maker;
    maker.place(test::gltf_card(1, 1));
    return maker;
  }
  void put(const fs::path& path, const std::vector<unsigned char>& bytes) const {
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
  }
};

TEST_F(GltfFiles, BothFormsOfAFileAreTheSameAsset) {
  const GltfMaker maker = test::wooden_box();
  maker.write_gltf(folder_.path() / "a.gltf");
  maker.write_glb(folder_.path() / "a.GLB");
  const auto text = import_mesh(folder_.path() / "a.gltf", kPaper),
             binary = import_mesh(folder_.path() / "a.GLB", kPaper);
  ASSERT_TRUE(text) << text.error().detail;
  ASSERT_TRUE(binary) << binary.error().detail;
  EXPECT_EQ(text->mesh.positions, binary->mesh.positions);
  EXPECT_EQ(text->mesh.albedo, binary->mesh.albedo);
  EXPECT_EQ(text->surface->coordinates, binary->surface->coordinates);
  EXPECT_EQ(text->surface->materials[0].base_colour_map.picture->codes,
            binary->surface->materials[0].base_colour_map.picture->codes);
}

TEST_F(GltfFiles, PicturesAndBuffersMayLieBesideTheAssetOrBelow) {
  const auto png = test::encoded(picture(2, 2, {9, 8, 7, 6}), ".png");
  fs::create_directory(folder_.path() / "my pictures");
  put(folder_.path() / "my pictures" / "a.png", png);
  GltfMaker maker = card_with_picture("my%20pictures/a.png");
  put(folder_.path() / "data.bin", maker.bytes());
  maker.root["buffers"] = {{{"byteLength", maker.bytes().size()}, {"uri", "./data.bin"}}};
  maker.write_gltf(folder_.path() / "a.gltf");
  const auto import = import_mesh(folder_.path() / "a.gltf", kPaper);
  ASSERT_TRUE(import) << import.error().detail;
  const auto& held = *import->surface->materials[0].base_colour_map.picture;
  EXPECT_EQ(held.codes.at(1, 1), (Rgba8{9, 8, 7, 6}));
  EXPECT_EQ(held.file, png) << "the original bytes";
}

TEST_F(GltfFiles, NothingOutsideTheAssetsFolderIsRead) {
  const fs::path inside = folder_.path() / "asset";
  fs::create_directory(inside);
  const auto png = test::encoded(picture(2, 2, {9, 8, 7, 255}), ".png");
  put(folder_.path() / "secret.png", png);
  put(inside / "here.png", png);
  fs::create_symlink(folder_.path() / "secret.png", inside / "link.png");
  fs::create_symlink(folder_.path(), inside / "up");
  const std::string absolute = (folder_.path() / "secret.png").string();
  for (const std::string& uri :
       {std::string("../secret.png"), std::string("%2e%2e/secret.png"),
        std::string("x/../../secret.png"), absolute, std::string("link.png"),
        std::string("up/secret.png"), std::string("http://a.example/b.png"),
        std::string("https://a.example/b.png"), "file://" + absolute, std::string("//host/b.png"),
        std::string("here.png%00"), std::string("%4")}) {
    card_with_picture(uri).write_gltf(inside / "a.gltf");
    const auto import = import_mesh(inside / "a.gltf", kPaper);
    ASSERT_FALSE(import) << uri;
    EXPECT_EQ(import.error().code, ErrorCode::kInvalid) << uri;
    EXPECT_TRUE(has(import.error().detail, "image 0")) << import.error().detail;
  }
  card_with_picture("../asset/here.png").write_gltf(inside / "a.gltf");
  EXPECT_TRUE(import_mesh(inside / "a.gltf", kPaper)) << "a way out and in again is inside";
}

TEST_F(GltfFiles, AMissingPictureIsNamed) {
  const std::string why = refused(card_with_picture("absent.png"), ErrorCode::kNotFound);
  EXPECT_TRUE(has(why, "image 0") && has(why, "absent.png")) << why;
}

TEST_F(GltfFiles, PicturesOfOtherKindsAreRefusedWithWhatToDo) {
  const std::pair<std::string, const char*> kinds[] = {
      {"\xabKTX 20\xbb\r\n\x1a\n", "KTX"},
      {std::string("RIFF\x10\0\0\0WEBPVP8 ", 16), "WebP"},
      {"GIF89a", "neither PNG nor JPEG"}};
  for (const auto& [bytes, name] : kinds) {
    GltfMaker maker = card_with_picture("");
    maker.root["images"][0] = {{"bufferView", maker.view(bytes.data(), bytes.size())}};
    const std::string why = refused(maker, ErrorCode::kInvalid);
    EXPECT_TRUE(has(why, name) && has(why, "save it as PNG or JPEG")) << why;
  }
  GltfMaker basis = card_with_picture("");
  basis.root["textures"][0] = {{"extensions", {{"KHR_texture_basisu", {{"source", 0}}}}}};
  EXPECT_TRUE(has(refused(basis, ErrorCode::kInvalid), "KHR_texture_basisu"));
}

TEST_F(GltfFiles, PicturesTooLargeAreRefusedBeforeTheyAreDecoded) {
  // A PNG's header alone: 65536 by 65536.
  std::vector<unsigned char> png = test::encoded(picture(1, 1, {0, 0, 0, 255}), ".png");
  png[16 + 1] = png[20 + 1] = 1;
  GltfMaker maker = card_with_picture("");
  maker.root["images"][0] = {{"name", "huge"}, {"bufferView", maker.view(png.data(), png.size())}};
  const std::string why = refused(maker, ErrorCode::kInvalid);
  EXPECT_TRUE(has(why, "\"huge\"") && has(why, "megapixels")) << why;
  std::vector<unsigned char> jpeg = test::encoded(picture(8, 8, {0, 0, 0, 255}), ".jpg");
  for (std::size_t i = 0; i + 9 < jpeg.size(); ++i)
    if (jpeg[i] == 0xff && jpeg[i + 1] == 0xc0) jpeg[i + 5] = jpeg[i + 7] = 0xff;
  maker.root["images"][0] = {{"bufferView", maker.view(jpeg.data(), jpeg.size())}};
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "megapixels"));
}

TEST_F(GltfFiles, ADamagedPictureIsAnError) {
  const auto png = test::encoded(picture(64, 64, {1, 2, 3, 255}), ".png");
  GltfMaker maker = card_with_picture("");
  maker.root["images"][0] = {{"bufferView", maker.view(png.data(), png.size() / 2)}};
  EXPECT_TRUE(has(refused(maker, ErrorCode::kUnreadable), "image 0"));
}

TEST_F(GltfFiles, RequiredExtensionsThatAreNotReadAreRefusedByName) {
  GltfMaker maker = card();
  maker.use("VENDOR_everything", true);
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "VENDOR_everything"));
  GltfMaker basis = card();
  basis.use("KHR_texture_basisu", true);
  EXPECT_TRUE(has(refused(basis, ErrorCode::kInvalid), "save its textures as PNG or JPEG"));
}

TEST_F(GltfFiles, OtherVersionsAreRefused) {
  GltfMaker maker = card();
  maker.root["asset"]["version"] = "1.0";
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "glTF 1.0"));
  maker.root["asset"].erase("version");
  (void)refused(maker, ErrorCode::kUnreadable);
}

// Each case damages a good file in one place, and the reason names it.
TEST_F(GltfFiles, BrokenReferencesAreNamed) {
  const std::pair<const char*, const char*> cases[] = {
      {R"([{"op":"replace","path":"/nodes/0/mesh","value":7}])", "node 0"},
      {R"([{"op":"replace","path":"/nodes/0/mesh","value":-1}])", "node 0"},
      {R"([{"op":"replace","path":"/nodes/0/mesh","value":"a"}])", "node 0"},
      {R"([{"op":"add","path":"/nodes/0/children","value":[0]}])", "node 0"},
      {R"([{"op":"add","path":"/nodes/0/children","value":[9]}])", "node 0"},
      {R"([{"op":"add","path":"/nodes/0/children","value":7}])", "node 0"},
      {R"([{"op":"add","path":"/nodes/0/matrix","value":[1,2]}])", "node 0"},
      {R"([{"op":"add","path":"/nodes/0/rotation","value":["a",0,0,1]}])", "node 0"},
      {R"([{"op":"replace","path":"/scene","value":3}])", "scene"},
      {R"([{"op":"replace","path":"/scenes/0/nodes","value":[0,0]}])", "node 0"},
      {R"([{"op":"replace","path":"/scenes/0/nodes","value":[5]}])", "scene"},
      {R"([{"op":"replace","path":"/meshes/0/primitives","value":{}}])", "mesh 0"},
      {R"([{"op":"replace","path":"/meshes/0/primitives/0/indices","value":99}])", "mesh 0"},
      {R"([{"op":"replace","path":"/meshes/0/primitives/0/attributes/POSITION","value":99}])",
       "mesh 0"},
      {R"([{"op":"remove","path":"/meshes/0/primitives/0/attributes/POSITION"}])", "mesh 0"},
      {R"([{"op":"add","path":"/meshes/0/primitives/0/material","value":4}])", "mesh 0"},
      {R"([{"op":"add","path":"/meshes/0/primitives/0/mode","value":12}])", "mesh 0"},
      {R"([{"op":"replace","path":"/accessors/0/count","value":400000000}])", "accessor 0"},
      {R"([{"op":"replace","path":"/accessors/0/count","value":5}])", "accessor 0"},
      {R"([{"op":"replace","path":"/accessors/0/count","value":0}])", "accessor 0"},
      {R"([{"op":"replace","path":"/accessors/0/type","value":"MAT4"}])", "accessor 0"},
      {R"([{"op":"replace","path":"/accessors/0/type","value":"VEC2"}])", "accessor 0"},
      {R"([{"op":"replace","path":"/accessors/0/componentType","value":5124}])", "accessor 0"},
      {R"([{"op":"add","path":"/accessors/0/byteOffset","value":18446744073709551600}])",
       "accessor 0"},
      {R"([{"op":"replace","path":"/accessors/1/componentType","value":5126}])", "accessor 1"},
      {R"([{"op":"replace","path":"/accessors/0/bufferView","value":77}])", "accessor 0"},
      {R"([{"op":"add","path":"/bufferViews/0/byteStride","value":4}])", "accessor 0"},
      {R"([{"op":"add","path":"/bufferViews/0/byteStride","value":999}])", "buffer view 0"},
      {R"([{"op":"replace","path":"/bufferViews/0/byteLength","value":99999999}])",
       "buffer view 0"},
      {R"([{"op":"replace","path":"/bufferViews/0/byteOffset","value":18446744073709551615}])",
       "buffer view 0"},
      {R"([{"op":"replace","path":"/bufferViews/0/buffer","value":3}])", "buffer view 0"},
      {R"([{"op":"add","path":"/buffers","value":[{"byteLength":99999999}]}])", "buffer 0"},
      {R"([{"op":"add","path":"/accessors/0/sparse","value":{"count":1}}])", "accessor 0"}};
  ASSERT_EQ(read(card()).mesh.triangles.size(), 2u) << "the damage must be the cause";
  for (const auto& [damage, name] : cases) {
    GltfMaker maker = card();
    maker.root = maker.root.patch(json::parse(damage));
    const std::string why = refused(maker, ErrorCode::kInvalid);
    EXPECT_TRUE(has(why, name)) << damage << ": " << why;
  }
}

TEST_F(GltfFiles, AnIndexBeyondTheVerticesIsNamed) {
  GltfMaker maker;
  auto shape = test::gltf_card(1, 1);
  shape.indices[4] = 4;
  maker.place(shape);
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "index 4, and 4 vertices"));
}

TEST_F(GltfFiles, ANodeOfTwoParentsIsRefused) {
  GltfMaker maker = card();
  maker.node({{"children", {2}}});
  maker.add("nodes", {{"mesh", 0}, {"name", "shared"}});
  maker.node({{"children", {2}}});
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "(\"shared\") has two parents"));
}

TEST_F(GltfFiles, VerticesThatAreNotFiniteOrTooFarAreNamed) {
  for (const auto& [value, code] :
       {std::pair{std::numeric_limits<float>::quiet_NaN(), ErrorCode::kNonFinite},
        {std::numeric_limits<float>::infinity(), ErrorCode::kNonFinite},
        {3e9f, ErrorCode::kInvalid}}) {
    GltfMaker maker;
    auto shape = test::gltf_card(1, 1);
    shape.positions[2].y = value;
    json primitive = {
        {"attributes", {{"POSITION", maker.floats({0, 0, 0, 1, 0, 0, 0, value, 0}, 3)}}}};
    maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
    EXPECT_TRUE(has(refused(maker, code), "vertex 2 of mesh 0")) << value;
  }
}

TEST_F(GltfFiles, AShortFileMayNotPlaceAnEndlessMesh) {
  GltfMaker maker;
  maker.use("EXT_mesh_gpu_instancing");
  const int mesh = maker.mesh(json::array({maker.primitive(test::gltf_sphere(1, 60))}));
  const std::vector<float> places(3 * 20'000);
  const int accessor = maker.floats(places, 3);
  maker.node({{"mesh", mesh},
              {"extensions",
               {{"EXT_mesh_gpu_instancing", {{"attributes", {{"TRANSLATION", accessor}}}}}}}});
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "vertices"));
  maker.root["accessors"][static_cast<std::size_t>(accessor)].erase("bufferView");
  maker.root["accessors"][static_cast<std::size_t>(accessor)]["count"] = 500'000;
  EXPECT_TRUE(has(refused(maker, ErrorCode::kInvalid), "instances"));
}

TEST_F(GltfFiles, TruncatedAnywhereIsAnErrorAndNeverACrash) {
  const auto whole = test::masked_leaf().glb();
  for (std::size_t length = 0; length < whole.size(); length += length < 64 ? 1 : 1 + length / 9) {
    const std::vector<unsigned char> part(whole.begin(),
                                          whole.begin() + static_cast<std::ptrdiff_t>(length));
    EXPECT_FALSE(gltf::import_bytes(part, "a.glb", kPaper)) << length;
  }
}

TEST_F(GltfFiles, RandomDamageNeverCrashes) {
  GltfMaker maker;
  maker.use("EXT_mesh_gpu_instancing"), maker.use("KHR_texture_transform");
  json primitive = maker.primitive(test::gltf_box({1, 1, 1}));
  const json transform = {{"KHR_texture_transform", {{"scale", {2, 2}}}}};
  primitive["material"] = maker.material(
      {{"pbrMetallicRoughness",
        {{"baseColorTexture",
          {{"index", maker.texture(picture(4, 4, {9, 9, 9, 9}))}, {"extensions", transform}}}}},
       {"normalTexture", {{"index", 0}}}});
  const json instances = {{"attributes", {{"TRANSLATION", maker.floats({0, 0, 0, 1, 1, 1}, 3)}}}};
  maker.node({{"mesh", maker.mesh(json::array({primitive}))},
              {"extensions", {{"EXT_mesh_gpu_instancing", instances}}}});
  int sound = 0;
  test::mutate_and_run(maker.glb(), 3000, 11, [&](std::span<const unsigned char> bytes) {
    const auto import = gltf::import_bytes({bytes.begin(), bytes.end()}, "a.glb", kPaper);
    if (!import) return;
    ++sound;
    for (const auto& t : import->mesh.triangles)
      for (const auto i : t) ASSERT_LT(i, import->mesh.positions.size());
    for (const Rgb& a : import->mesh.albedo)
      for (int c = 0; c < 3; ++c) ASSERT_TRUE(a[c] >= 0 && a[c] <= 1);
    if (!import->surface) return;
    ASSERT_EQ(import->surface->material.size(), import->mesh.positions.size());
    for (const auto m : import->surface->material) ASSERT_LT(m, import->surface->materials.size());
  });
  EXPECT_GT(sound, 100) << "damage that is too great finds nothing";
}

}  // namespace
}  // namespace penumbra::prt
