#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>
#include <meshoptimizer.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "tests/fuzz/mutate.h"
#include "tests/prt/gltf_fixture.h"
#include "tests/support/gltf_assets.h"

namespace penumbra::prt {
namespace {

using nlohmann::json;
using test::GltfMaker;
using test::GltfShape;

class GltfCompression : public GltfFixture {
 protected:
  // A material that asks for coordinates.
  static int textured(GltfMaker& maker) {
    return maker.material(
        {{"pbrMetallicRoughness",
          {{"baseColorTexture", {{"index", maker.texture(picture(2, 2, {50, 60, 70, 255}))}}}}}});
  }
};

std::size_t place(const json& index) {
  return index.get<std::size_t>();
}

// ------------------------------------------------------------------------------------- meshopt

// Packs the view of an accessor; what it held before stays in the buffer, where nothing names it.
void pack(GltfMaker& maker, const json& accessor, std::size_t stride, const std::string& mode,
          const std::vector<unsigned char>& packed, const std::string& filter = "NONE") {
  json& a = maker.root["accessors"][place(accessor)];
  const int bytes = maker.view(packed.data(), packed.size());
  json& views = maker.root["bufferViews"];
  json extension = views[static_cast<std::size_t>(bytes)];
  views.erase(static_cast<std::size_t>(bytes));
  extension["byteStride"] = stride;
  extension["count"] = a["count"];
  extension["mode"] = mode;
  if (filter != "NONE") extension["filter"] = filter;
  json& view = views[place(a["bufferView"])];
  // As files without a fallback have it: another buffer, which holds nothing.
  view = {{"buffer", 1},
          {"byteLength", stride * a["count"].get<std::size_t>()},
          {"extensions", {{"EXT_meshopt_compression", extension}}}};
  if (mode == "ATTRIBUTES") view["byteStride"] = stride;
}

template <class T>
std::vector<unsigned char> vertices_packed(const std::vector<T>& data) {
  std::vector<unsigned char> out(meshopt_encodeVertexBufferBound(data.size(), sizeof(T)));
  out.resize(
      meshopt_encodeVertexBuffer(out.data(), out.size(), data.data(), data.size(), sizeof(T)));
  return out;
}

std::vector<unsigned char> indices_packed(const std::vector<std::uint32_t>& data,
                                          std::size_t vertices, bool triangles) {
  std::vector<unsigned char> out(triangles
                                     ? meshopt_encodeIndexBufferBound(data.size(), vertices)
                                     : meshopt_encodeIndexSequenceBound(data.size(), vertices));
  out.resize(triangles
                 ? meshopt_encodeIndexBuffer(out.data(), out.size(), data.data(), data.size())
                 : meshopt_encodeIndexSequence(out.data(), out.size(), data.data(), data.size()));
  return out;
}

void finish_packing(GltfMaker& maker) {
  maker.use("EXT_meshopt_compression", true);
  maker.root["buffers"] = {{{"byteLength", maker.bytes().size()}},
                           {{"byteLength", 1 << 20},
                            {"extensions", {{"EXT_meshopt_compression", {{"fallback", true}}}}}}};
}

GltfMaker ball_by_meshopt(bool triangles) {
  GltfMaker maker;
  const GltfShape ball = test::gltf_sphere(1, 16);
  json primitive = maker.primitive(ball);
  pack(maker, primitive["attributes"]["POSITION"], 12, "ATTRIBUTES",
       vertices_packed(ball.positions));
  pack(maker, primitive["indices"], 4, triangles ? "TRIANGLES" : "INDICES",
       indices_packed(ball.indices, ball.positions.size(), triangles));
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  finish_packing(maker);
  return maker;
}

TEST_F(GltfCompression, MeshoptIsWhatWasPacked) {
  GltfMaker plain;
  plain.place(test::gltf_sphere(1, 16));
  const Mesh a = read(plain).mesh;
  for (const bool triangles : {false, true}) {
    const Mesh b = read(ball_by_meshopt(triangles)).mesh;
    ASSERT_EQ(a.triangles.size(), b.triangles.size());
    // The encoder may turn each triangle; its places stay.
    for (std::size_t i = 0; i < a.triangles.size(); ++i) {
      glm::vec3 before(0), after(0);
      for (std::size_t k = 0; k < 3; ++k)
        before += a.positions[a.triangles[i][k]], after += b.positions[b.triangles[i][k]];
      EXPECT_LT(glm::distance(before, after), 1e-5f);
    }
  }
}

TEST_F(GltfCompression, FiltersOfMeshoptGiveNormalsAndNumbersBack) {
  GltfMaker maker;
  maker.use("KHR_mesh_quantization", true);
  const GltfShape ball = test::gltf_sphere(1, 16);
  json primitive = maker.primitive(ball);
  std::vector<float> normals;
  for (const glm::vec3& n : ball.normals) normals.insert(normals.end(), {n.x, n.y, n.z, 0});
  std::vector<std::array<std::int16_t, 4>> octahedral(ball.normals.size());
  meshopt_encodeFilterOct(octahedral.data(), octahedral.size(), 8, 12, normals.data());
  pack(maker, primitive["attributes"]["NORMAL"], 8, "ATTRIBUTES", vertices_packed(octahedral),
       "OCTAHEDRAL");
  json& accessor = maker.root["accessors"][place(primitive["attributes"]["NORMAL"])];
  accessor["componentType"] = 5122, accessor["normalized"] = true;
  std::vector<std::array<std::uint32_t, 3>> exponential(ball.positions.size());
  meshopt_encodeFilterExp(exponential.data(), exponential.size(), 12, 15, &ball.positions[0].x);
  pack(maker, primitive["attributes"]["POSITION"], 12, "ATTRIBUTES", vertices_packed(exponential),
       "EXPONENTIAL");
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  finish_packing(maker);
  const Mesh mesh = read(maker).mesh;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const glm::vec3 out = mesh.positions[i] - glm::vec3(0, 1, 0);
    EXPECT_NEAR(glm::length(out), 1, 1e-3);
    EXPECT_GT(glm::dot(glm::normalize(out), mesh.normals[i]), .9999f);
  }
}

TEST_F(GltfCompression, DamagedMeshoptIsNamed) {
  GltfMaker maker = ball_by_meshopt(true);
  const json& accessors = maker.root["accessors"];
  const auto view = place(accessors[0]["bufferView"]);
  json& e = maker.root["bufferViews"][view]["extensions"]["EXT_meshopt_compression"];
  const json good = e;
  const std::string whose = "buffer view " + std::to_string(view);
  const auto refused_with = [&](const char* key, const json& value, ErrorCode code) {
    e = good;
    e[key] = value;
    EXPECT_NE(refused(maker, code).find(whose), std::string::npos) << key;
  };
  refused_with("mode", "NOTHING", ErrorCode::kInvalid);
  refused_with("filter", "NOTHING", ErrorCode::kInvalid);
  refused_with("filter", "QUATERNION", ErrorCode::kInvalid);
  refused_with("byteStride", 0, ErrorCode::kInvalid);
  refused_with("byteStride", 10, ErrorCode::kInvalid);
  refused_with("count", 1u << 30, ErrorCode::kInvalid);
  refused_with("count", 100'000, ErrorCode::kUnreadable);
  refused_with("byteLength", 7, ErrorCode::kUnreadable);
  refused_with("byteLength", 1 << 30, ErrorCode::kInvalid);
}

// ------------------------------------------------------------------------------------- Draco

std::vector<unsigned char> draco_packed(const GltfShape& shape, json& attributes) {
  draco::Mesh mesh;
  mesh.set_num_points(static_cast<std::uint32_t>(shape.positions.size()));
  const auto add = [&](draco::GeometryAttribute::Type type, const float* data, int components,
                       const char* name) {
    draco::GeometryAttribute a;
    a.Init(type, nullptr, static_cast<std::int8_t>(components), draco::DT_FLOAT32, false,
           4 * components, 0);
    const int id = mesh.AddAttribute(a, true, mesh.num_points());
    for (std::uint32_t i = 0; i < mesh.num_points(); ++i)
      mesh.attribute(id)->SetAttributeValue(draco::AttributeValueIndex(i),
                                            data + i * static_cast<std::uint32_t>(components));
    attributes[name] = mesh.attribute(id)->unique_id();
  };
  add(draco::GeometryAttribute::POSITION, &shape.positions[0].x, 3, "POSITION");
  add(draco::GeometryAttribute::NORMAL, &shape.normals[0].x, 3, "NORMAL");
  for (std::size_t i = 0; i < shape.indices.size(); i += 3)
    mesh.AddFace({draco::PointIndex(shape.indices[i]), draco::PointIndex(shape.indices[i + 1]),
                  draco::PointIndex(shape.indices[i + 2])});
  draco::Encoder encoder;
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, 14);
  encoder.SetAttributeQuantization(draco::GeometryAttribute::NORMAL, 10);
  encoder.SetEncodingMethod(draco::MESH_SEQUENTIAL_ENCODING);  // vertices keep their order
  draco::EncoderBuffer buffer;
  EXPECT_TRUE(encoder.EncodeMeshToBuffer(mesh, &buffer).ok());
  return {buffer.data(), buffer.data() + buffer.size()};
}

// Positions and normals are packed, coordinates are not.
GltfMaker ball_by_draco(const GltfShape& ball, int (*material)(GltfMaker&)) {
  GltfMaker maker;
  maker.use("KHR_draco_mesh_compression", true);
  json packed = json::object();
  const auto bytes = draco_packed(ball, packed);
  const auto bare = [&](int component, const char* type, std::size_t count) {
    return maker.add("accessors", {{"componentType", component}, {"type", type}, {"count", count}});
  };
  json primitive = {{"attributes",
                     {{"POSITION", bare(5126, "VEC3", ball.positions.size())},
                      {"NORMAL", bare(5126, "VEC3", ball.positions.size())},
                      {"TEXCOORD_0", maker.vec2(ball.coordinates)}}},
                    {"indices", bare(5125, "SCALAR", ball.indices.size())},
                    {"material", material(maker)}};
  primitive["extensions"]["KHR_draco_mesh_compression"] = {
      {"bufferView", maker.view(bytes.data(), bytes.size())}, {"attributes", packed}};
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  return maker;
}

TEST_F(GltfCompression, DracoIsWhatWasPackedAsFineAsItsBits) {
  const GltfShape ball = test::gltf_sphere(1, 16);
  GltfMaker plain;
  plain.place(ball, textured(plain));
  const Import a = read(plain), b = read(ball_by_draco(ball, textured));
  ASSERT_EQ(a.mesh.triangles.size(), b.mesh.triangles.size());
  ASSERT_EQ(a.mesh.positions.size(), b.mesh.positions.size());
  for (std::size_t i = 0; i < a.mesh.positions.size(); ++i) {
    EXPECT_LT(glm::distance(a.mesh.positions[i], b.mesh.positions[i]), 2.f / (1 << 13));
    EXPECT_GT(glm::dot(a.mesh.normals[i], b.mesh.normals[i]), .9999f);
    EXPECT_EQ(a.surface->coordinates[0][i], b.surface->coordinates[0][i]);
  }
}

TEST_F(GltfCompression, DamagedDracoIsNamed) {
  GltfMaker maker = ball_by_draco(test::gltf_sphere(1, 8), textured);
  json& e = maker.root["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"];
  const json good = e;
  e["attributes"]["COLOR_0"] = 77;
  EXPECT_NE(refused(maker, ErrorCode::kInvalid).find("lacks its COLOR_0"), std::string::npos);
  e = good, e.erase("bufferView");
  EXPECT_NE(refused(maker, ErrorCode::kInvalid).find("mesh 0"), std::string::npos);
  e = good, e["attributes"] = 3;
  EXPECT_NE(refused(maker, ErrorCode::kInvalid).find("mesh 0"), std::string::npos);
  e = good;
  maker.root["bufferViews"][place(e["bufferView"])]["byteLength"] = 30;
  EXPECT_NE(refused(maker, ErrorCode::kUnreadable).find("mesh 0 (\"thing\"), packed by Draco"),
            std::string::npos);
}

TEST_F(GltfCompression, RandomDamageToPackedBytesNeverCrashes) {
  int sound = 0;
  for (const GltfMaker& maker :
       {ball_by_meshopt(true), ball_by_draco(test::gltf_sphere(1, 6), textured)})
    test::mutate_and_run(maker.glb(), 400, 5, [&](std::span<const unsigned char> bytes) {
      sound += gltf::import_bytes({bytes.begin(), bytes.end()}, "a.glb", kPaper).has_value();
    });
  EXPECT_GT(sound, 10);
}

}  // namespace
}  // namespace penumbra::prt
