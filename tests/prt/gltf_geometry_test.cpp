#include <cmath>
#include <cstring>
#include <glm/geometric.hpp>
#include <limits>
#include <set>

#include "tests/prt/gltf_fixture.h"

namespace penumbra::prt {
namespace {

using nlohmann::json;
using test::GltfMaker;
using test::GltfShape;

class GltfGeometry : public GltfFixture {};

glm::vec3 face_normal(const Mesh& mesh, std::size_t triangle) {
  const auto& t = mesh.triangles[triangle];
  const auto& p = mesh.positions;
  return glm::cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]);
}

float total_area(const Mesh& mesh) {
  float area = 0;
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i)
    area += .5f * glm::length(face_normal(mesh, i));
  return area;
}

// Signed: positive where triangles go counter-clockwise seen from outside.
double volume(const Mesh& mesh) {
  double sum = 0;
  for (const auto& t : mesh.triangles)
    sum +=
        glm::dot(glm::dvec3(mesh.positions[t[0]]),
                 glm::cross(glm::dvec3(mesh.positions[t[1]]), glm::dvec3(mesh.positions[t[2]]))) /
        6;
  return sum;
}

void expect_same_way(const Mesh& mesh) {
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i)
    for (const auto v : mesh.triangles[i])
      ASSERT_GT(glm::dot(face_normal(mesh, i), mesh.normals[v]), 0) << i;
}

GltfMaker strip_of(std::uint64_t mode) {
  GltfMaker maker;
  GltfShape shape;
  // A strip of four triangles along x; for a fan the same half-octagon around its first vertex.
  if (mode == 5) {
    for (int i = 0; i < 6; ++i) shape.positions.emplace_back(.5f * static_cast<float>(i), i % 2, 0);
  } else {
    shape.positions.emplace_back(0, 0, 0);
    for (int i = 0; i <= 4; ++i)
      shape.positions.emplace_back(std::cos(.785398f * static_cast<float>(i)),
                                   std::sin(.785398f * static_cast<float>(i)), 0);
  }
  json primitive = {{"attributes", {{"POSITION", maker.vec3(shape.positions)}}}, {"mode", mode}};
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  return maker;
}

TEST_F(GltfGeometry, StripsAndFansAreTheirTrianglesAllOneWayRound) {
  const Mesh strip = read(strip_of(5)).mesh, fan = read(strip_of(6)).mesh;
  EXPECT_EQ(strip.triangles.size(), 4u);
  EXPECT_NEAR(total_area(strip), 4 * .5f, 1e-5);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_LT(face_normal(strip, i).z, 0) << i;
  EXPECT_EQ(fan.triangles.size(), 4u);
  EXPECT_NEAR(total_area(fan), 4 * .5f * std::sin(.785398f), 1e-5);
  for (std::size_t i = 0; i < 4; ++i) EXPECT_GT(face_normal(fan, i).z, 0) << i;
}

TEST_F(GltfGeometry, PointsAndLinesAreLeftOutAndSaid) {
  for (const int mode : {0, 1, 2, 3}) {
    GltfMaker maker;
    json lines = {{"attributes", {{"POSITION", maker.vec3({{0, 0, 0}, {1, 0, 0}})}}},
                  {"mode", mode}};
    maker.node({{"mesh", maker.mesh({lines, maker.primitive(test::gltf_card(1, 1))})}});
    const Import import = read(maker);
    EXPECT_EQ(import.mesh.triangles.size(), 2u);
    EXPECT_TRUE(says(import, mode == 0 ? "points" : "lines")) << mode;
  }
}

TEST_F(GltfGeometry, AMirroredNodeKeepsItsOutside) {
  GltfMaker maker;
  const int mesh = maker.mesh(json::array({maker.primitive(test::gltf_box({1, 2, 3}))}));
  maker.node({{"mesh", mesh}, {"scale", {-1, 1, 1}}, {"translation", {5, 0, 0}}});
  const Mesh mirrored = read(maker).mesh;
  EXPECT_NEAR(volume(mirrored), 6, 1e-4) << "counter-clockwise seen from outside";
  expect_same_way(mirrored);
}

TEST_F(GltfGeometry, NormalsStandOnTheSurfaceWhateverTheScale) {
  GltfMaker maker;
  maker.node({{"mesh", maker.mesh(json::array({maker.primitive(test::gltf_sphere(1, 24))}))},
              {"scale", {1, .1, 3}}});
  const Mesh mesh = read(maker).mesh;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const glm::vec3 p = mesh.positions[i] - glm::vec3(0, .1f, 0);
    const glm::vec3 gradient = glm::normalize(p / glm::vec3(1, .01f, 9));
    EXPECT_GT(glm::dot(gradient, mesh.normals[i]), .9999f);
  }
}

TEST_F(GltfGeometry, InstancesAllStandWhereTheyAreTold) {
  GltfMaker maker;
  maker.use("EXT_mesh_gpu_instancing", true);
  const int mesh = maker.mesh(json::array({maker.primitive(test::gltf_box({1, 1, 1}))}));
  const float turn = std::sqrt(.5f);
  const std::int8_t turns[] = {0, 0, 0, 127, 0, 90, 0, 90,  0, 0, 0, 127,
                               0, 0, 0, 127, 0, 0,  0, 127, 0, 0, 0, 127};
  json attributes = {
      {"TRANSLATION", maker.floats({0, 0, 0, 3, 0, 0, 6, 0, 0, 9, 0, 0, 12, 0, 0, 15, 0, 0}, 3)},
      {"ROTATION", maker.accessor(turns, sizeof(turns), 5120, 4, 6, {{"normalized", true}})},
      {"SCALE", maker.floats({1, 1, 1, 1, 1, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, -1, 1, 1}, 3)}};
  maker.node({{"mesh", mesh},
              {"translation", {0, 10, 0}},
              {"extensions", {{"EXT_mesh_gpu_instancing", {{"attributes", attributes}}}}}});
  const Mesh all = read(maker).mesh;
  EXPECT_EQ(all.triangles.size(), 6u * 12);
  // The second is twice as deep and turned by a quarter about y, the sixth mirrored.
  EXPECT_NEAR(volume(all), 1 + 2 + 8 + 1 + 1 + 1, 1e-3);
  const Bounds b = bounds_of(all);
  EXPECT_NEAR(b.high.x, 15.5f, 1e-4);
  EXPECT_NEAR(b.low.y, 10, 1e-4);
  EXPECT_NEAR(turn, .7071f, 1e-4);
  float low = HUGE_VALF, high = -HUGE_VALF;
  for (const glm::vec3& p : all.positions)
    if (p.x > 1 && p.x < 4.5f) low = std::min(low, p.x), high = std::max(high, p.x);
  EXPECT_NEAR(high - low, 2, 1e-2) << "the second's depth lies along x";
}

TEST_F(GltfGeometry, SparseElementsReplaceThoseBelow) {
  GltfMaker maker;
  const auto shape = test::gltf_card(1, 1);
  json primitive = maker.primitive(shape);
  const std::uint16_t which[] = {2};
  const float place[] = {7, 0, 0};
  json& accessor = maker.root["accessors"][primitive["attributes"]["POSITION"].get<std::size_t>()];
  accessor["sparse"] = {
      {"count", 1},
      {"indices", {{"bufferView", maker.view(which, 2)}, {"componentType", 5123}}},
      {"values", {{"bufferView", maker.view(place, 12)}}}};
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  EXPECT_NEAR(bounds_of(read(maker).mesh).high.x, 7, 1e-6);
}

TEST_F(GltfGeometry, SparseElementsWithoutOthersStandOnZeros) {
  GltfMaker maker;
  const std::uint8_t which[] = {1, 2};
  const float places[] = {1, 0, 0, 0, 1, 0};
  const int accessor = maker.add(
      "accessors", {{"componentType", 5126},
                    {"type", "VEC3"},
                    {"count", 3},
                    {"sparse",
                     {{"count", 2},
                      {"indices", {{"bufferView", maker.view(which, 2)}, {"componentType", 5121}}},
                      {"values", {{"bufferView", maker.view(places, 24)}}}}}});
  json primitive = {{"attributes", {{"POSITION", accessor}}}};
  maker.node({{"mesh", maker.mesh(json::array({primitive}))}});
  EXPECT_NEAR(total_area(read(maker).mesh), .5, 1e-6);
}

TEST_F(GltfGeometry, QuantisedAttributesAreTheNumbersThatTheyStandFor) {
  const auto shape = test::gltf_box({1, 1, 1});
  GltfMaker plain, packed;
  plain.place(shape);
  std::vector<std::int16_t> positions;  // four a vertex: strides are multiples of 4
  std::vector<std::int8_t> normals;
  for (std::size_t i = 0; i < shape.positions.size(); ++i) {
    const glm::vec3 &p = shape.positions[i], &n = shape.normals[i];
    for (const float v : {p.x, p.y, p.z}) positions.push_back(static_cast<std::int16_t>(4 * v));
    positions.push_back(99);
    for (const float v : {n.x, n.y, n.z}) normals.push_back(static_cast<std::int8_t>(127 * v));
    normals.push_back(99);
  }
  packed.use("KHR_mesh_quantization", true);
  const auto strided = [&](const void* data, std::size_t bytes, int type, int stride, json more) {
    more["bufferView"] = packed.view(data, bytes, {{"byteStride", stride}});
    more["componentType"] = type, more["type"] = "VEC3", more["count"] = shape.positions.size();
    return packed.add("accessors", more);
  };
  json primitive = {
      {"attributes",
       {{"POSITION", strided(positions.data(), positions.size() * 2, 5122, 8, json::object())},
        {"NORMAL", strided(normals.data(), normals.size(), 5120, 4, {{"normalized", true}})}}},
      {"indices", packed.indices(shape.indices)}};
  packed.node({{"mesh", packed.mesh(json::array({primitive}))}, {"scale", {.25, .25, .25}}});
  const Mesh a = read(plain).mesh, b = read(packed).mesh;
  ASSERT_EQ(a.positions.size(), b.positions.size());
  EXPECT_EQ(a.triangles, b.triangles);
  for (std::size_t i = 0; i < a.positions.size(); ++i) {
    EXPECT_LT(glm::distance(a.positions[i], b.positions[i]), 1e-6f);
    EXPECT_LT(glm::distance(a.normals[i], b.normals[i]), 1e-6f);
  }
}

TEST_F(GltfGeometry, WithoutNormalsABoxIsFlatAndABallSmooth) {
  auto box = test::gltf_box({1, 1, 1}), ball = test::gltf_sphere(1, 24);
  box.normals.clear(), ball.normals.clear();
  GltfMaker boxes, balls;
  boxes.place(box), balls.place(ball);
  const Mesh flat = read(boxes).mesh, smooth = read(balls).mesh;
  EXPECT_EQ(flat.positions.size(), 24u);
  for (std::size_t i = 0; i < flat.triangles.size(); ++i)
    for (const auto v : flat.triangles[i])
      EXPECT_LT(glm::distance(flat.normals[v], glm::normalize(face_normal(flat, i))), 1e-5f);
  // Each place once, though the picture's seam and the poles have several vertices there.
  EXPECT_EQ(smooth.positions.size(), 23u * 48 + 2);
  for (std::size_t i = 0; i < smooth.positions.size(); ++i)
    EXPECT_GT(glm::dot(smooth.normals[i], smooth.positions[i] - glm::vec3(0, 1, 0)), .999f);
}

TEST_F(GltfGeometry, EqualVerticesBecomeOneAndOthersStay) {
  auto card = test::gltf_card(1, 1);
  GltfShape corners;  // each triangle with vertices of its own
  for (const auto i : card.indices) {
    corners.positions.push_back(card.positions[i]);
    corners.normals.push_back(card.normals[i]);
    corners.coordinates.push_back(card.coordinates[i]);
    corners.indices.push_back(static_cast<std::uint32_t>(corners.indices.size()));
  }
  GltfMaker maker;
  maker.place(corners);
  EXPECT_EQ(read(maker).mesh.positions.size(), 4u);
  // With a picture, another place in it is another vertex.
  corners.coordinates[0] += glm::vec2(1, 0);
  for (const bool textured : {false, true}) {
    GltfMaker split;
    json pbr = {{"metallicFactor", 0}};
    if (textured)
      pbr["baseColorTexture"] = {{"index", split.texture(picture(2, 2, {255, 255, 255, 255}))}};
    split.place(corners, split.material({{"pbrMetallicRoughness", pbr}}));
    EXPECT_EQ(read(split).mesh.positions.size(), textured ? 5u : 4u);
  }
}

TEST_F(GltfGeometry, NodesGoOnUnderTheirParentsAtAnyDepth) {
  GltfMaker maker;
  constexpr int kDepth = 20'000;  // deeper than a stack of calls may go
  const int mesh = maker.mesh(json::array({maker.primitive(test::gltf_card(1, 1))}));
  maker.node({{"translation", {.001, 0, 0}}, {"children", {1}}});
  for (int i = 1; i < kDepth; ++i)
    maker.add("nodes", {{"translation", {.001, 0, 0}}, {"children", {i + 1}}});
  maker.add("nodes", {{"mesh", mesh}});
  EXPECT_NEAR(bounds_of(read(maker).mesh).centre().x, .001f * kDepth, 1e-2);
}

TEST_F(GltfGeometry, OnlyTheChosenSceneIsRead) {
  GltfMaker maker;
  maker.place(test::gltf_card(1, 1));
  maker.place(test::gltf_card(4, 1));
  maker.root["scenes"] = {{{"nodes", {0}}}, {{"nodes", {1}}}};
  for (const int scene : {0, 1}) {
    maker.root["scene"] = scene;
    const Bounds b = bounds_of(read(maker).mesh);
    EXPECT_NEAR(b.high.x - b.low.x, scene == 0 ? 1 : 4, 1e-6);
  }
  maker.root.erase("scene"), maker.root.erase("scenes");
  EXPECT_EQ(read(maker).mesh.triangles.size(), 4u) << "without scenes all roots";
}

TEST_F(GltfGeometry, LightsCamerasSkinsAndUnknownExtensionsAreSaidByName) {
  GltfMaker maker;
  maker.place(test::gltf_card(1, 1));
  maker.use("KHR_lights_punctual"), maker.use("VENDOR_sparkle");
  maker.root["extensions"]["KHR_lights_punctual"]["lights"] = {{{"type", "point"}}};
  maker.root["cameras"] = {{{"type", "perspective"}}};
  maker.root["nodes"][0]["skin"] = 0;
  maker.root["nodes"][0]["name"] = "arm";
  const Import import = read(maker);
  for (const char* part : {"lights", "cameras", "VENDOR_sparkle", "\"arm\"): its skin"})
    EXPECT_TRUE(says(import, part)) << part;
  EXPECT_EQ(import.left_out.size(), 4u) << "each once";
  EXPECT_EQ(import.extensions, (std::vector<std::string>{"KHR_lights_punctual", "VENDOR_sparkle"}));
}

}  // namespace
}  // namespace penumbra::prt
