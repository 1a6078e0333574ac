
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "prt/prt.h"
#include "tests/support/gltf_files.h"
#include "tests/support/shared_data.h"
#include "tests/support/temp_folder.h"

namespace penumbra::prt {
namespace {

constexpr Rgb kGrey{.5f, .5f, .5f};

const Character& animated_walker() {
  static const Character c = make_walker(kGrey);
  return c;
}

Mesh mesh_at(const Character& c, int clip, double seconds) {
  Mesh mesh;
  deform(c, sample(c, c.clips[static_cast<std::size_t>(clip)], seconds), mesh);
  return mesh;
}

float largest_move(const Mesh& a, const Mesh& b) {
  float largest = 0;
  for (std::size_t i = 0; i < a.positions.size(); ++i)
    largest = std::max(largest, glm::distance(a.positions[i], b.positions[i]));
  return largest;
}

TEST(Animation, RestPoseIsTheMeshAtRest) {
  Mesh mesh;
  deform(animated_walker(), rest_pose(animated_walker()), mesh);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    EXPECT_LT(glm::distance(mesh.positions[i], animated_walker().positions[i]), 1e-5f);
    EXPECT_LT(glm::distance(mesh.normals[i], animated_walker().normals[i]), 1e-4f);
  }
}

TEST(Animation, ClipsGoOnFromTheirEndToTheirBegin) {
  const double length = animated_walker().clips[0].seconds;
  EXPECT_LT(largest_move(mesh_at(animated_walker(), 0, .3),
                         mesh_at(animated_walker(), 0, .3 + 3 * length)),
            1e-5f);
  EXPECT_LT(
      largest_move(mesh_at(animated_walker(), 0, length - 1e-4), mesh_at(animated_walker(), 0, 0)),
      .005f);
  EXPECT_LT(
      largest_move(mesh_at(animated_walker(), 0, -.2), mesh_at(animated_walker(), 0, length - .2)),
      1e-5f);
}

TEST(Animation, TheWalkerStandsOnTheFloorAndFacesOutwards) {
  for (double t = 0; t < 1.1; t += .09) {
    const Mesh mesh = mesh_at(animated_walker(), 0, t);
    EXPECT_NEAR(bounds_of(mesh).low.y, 0, .012f) << t;
    double volume = 0;
    for (const auto& tri : mesh.triangles)
      volume += glm::dot(mesh.positions[tri[0]],
                         glm::cross(mesh.positions[tri[1]], mesh.positions[tri[2]])) /
                6;
    EXPECT_GT(volume, .05) << t;  // cubic metres, of parts that overlap
  }
}

TEST(Animation, BlendingEndsAtItsPosesAndStaysOnTheArc) {
  const CharacterPose a = sample(animated_walker(), animated_walker().clips[0], .2),
                      b = sample(animated_walker(), animated_walker().clips[1], .7);
  const CharacterPose none = blend(a, b, 0), all = blend(a, b, 1), half = blend(a, b, .5f);
  for (std::size_t i = 0; i < a.nodes.size(); ++i) {
    EXPECT_GT(std::abs(glm::dot(none.nodes[i].rotation, a.nodes[i].rotation)), 1 - 1e-6f);
    EXPECT_GT(std::abs(glm::dot(all.nodes[i].rotation, b.nodes[i].rotation)), 1 - 1e-6f);
    EXPECT_NEAR(glm::length(half.nodes[i].rotation), 1, 1e-5f);
    EXPECT_NEAR(std::abs(glm::dot(half.nodes[i].rotation, a.nodes[i].rotation)),
                std::abs(glm::dot(half.nodes[i].rotation, b.nodes[i].rotation)), 1e-4f);
  }
}

TEST(Animation, BonesTurnAsTheirVerticesDo) {
  Character c = animated_walker();
  CharacterPose pose = rest_pose(c);
  pose.nodes[0].rotation = glm::angleAxis(.7f, glm::vec3(0, 1, 0));
  const auto turns = bone_turns(c, pose);
  const glm::mat3 expected = glm::mat3_cast(pose.nodes[0].rotation);
  for (const glm::mat3& turn : turns)
    for (int k = 0; k < 3; ++k) EXPECT_LT(glm::distance(turn[k], expected[k]), 1e-5f);
  Mesh mesh;
  deform(c, pose, mesh);
  for (std::size_t i = 0; i < mesh.normals.size(); i += 37)
    EXPECT_LT(glm::distance(mesh.normals[i], expected * c.normals[i]), 1e-4f);
  // Neither scale nor mirroring makes them anything but rotations.
  c.frame = glm::scale(glm::mat4(1), glm::vec3(2, .5f, -3));
  for (const glm::mat3& turn : bone_turns(c, pose)) EXPECT_NEAR(glm::determinant(turn), 1, 1e-4f);
}

TEST(Animation, AMirroringFrameKeepsTheOutsideOut) {
  Character c = animated_walker();
  c.frame = glm::scale(glm::mat4(1), glm::vec3(-1, 1, 1));
  const Mesh mesh = mesh_at(c, 0, .4);
  std::size_t agree = 0;
  for (const auto& t : mesh.triangles) {
    const glm::vec3 n = glm::cross(mesh.positions[t[1]] - mesh.positions[t[0]],
                                   mesh.positions[t[2]] - mesh.positions[t[0]]);
    agree += glm::dot(n, mesh.normals[t[0]]) > 0;
  }
  EXPECT_GT(static_cast<double>(agree), .98 * static_cast<double>(mesh.triangles.size()));
}

TEST(Animation, SubdividingMovesNoVertex) {
  Character fine = animated_walker();
  subdivide(fine, .03f);
  ASSERT_GT(fine.positions.size(), animated_walker().positions.size());
  EXPECT_EQ(fine.influences.size(), fine.positions.size());
  EXPECT_EQ(fine.texture_coordinates.size(), fine.positions.size());
  const Mesh a = mesh_at(animated_walker(), 0, .5), b = mesh_at(fine, 0, .5);
  EXPECT_LT(largest_move(a, b), 1e-6f);
  for (const Character::Influence& f : fine.influences) {
    float sum = 0;
    for (const float w : f.weight) sum += w;
    EXPECT_NEAR(sum, 1, 1e-5f);
  }
}

TEST(CharacterImport, ASkinBends) {
  const test::TempFolder folder;
  const auto file = folder.path() / "quad.gltf";
  test::write_bending_quad(file, {1, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, .5f, .5f, 0, 0});
  const auto c = import_character(file, kGrey);
  ASSERT_TRUE(c) << c.error().detail;
  ASSERT_EQ(c->clips.size(), 1u);
  EXPECT_EQ(c->clips[0].name, "Bend");
  EXPECT_DOUBLE_EQ(c->clips[0].seconds, 1);
  EXPECT_EQ(c->unbound_vertices, 0u);
  const Mesh mesh = mesh_at(*c, 0, 1 - 1e-9);
  // (0, 2, 0) hangs on the upper joint at (0, 1, 0), which has turned by a quarter: up became left.
  EXPECT_LT(glm::distance(mesh.positions[0], {0, 0, 0}), 1e-5f);
  EXPECT_LT(glm::distance(mesh.positions[2], {-1, 1, 0}), 1e-5f);
  // Half by each: the mean of (1, 2, 0) and (-1, 2, 0).
  EXPECT_LT(glm::distance(mesh.positions[3], {0, 2, 0}), 1e-5f);
}

TEST(CharacterImport, VerticesWithoutWeightsFollowTheFirstJoint) {
  const test::TempFolder folder;
  const auto file = folder.path() / "quad.gltf";
  test::write_bending_quad(file, {0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0});
  const auto c = import_character(file, kGrey);
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_EQ(c->unbound_vertices, 2u);
  const Mesh mesh = mesh_at(*c, 0, .5);
  EXPECT_LT(glm::distance(mesh.positions[2], {0, 2, 0}), 1e-5f);
  for (const glm::vec3& p : mesh.positions) EXPECT_TRUE(std::isfinite(p.x + p.y + p.z));
}

TEST(CharacterImport, NodesMoveAndMorphTargetsGrow) {
  const test::TempFolder folder;
  const auto file = folder.path() / "triangle.gltf";
  test::write_morphing_triangle(file);
  const auto c = import_character(file, kGrey);
  ASSERT_TRUE(c) << c.error().detail;
  ASSERT_EQ(c->morph_targets.size(), 1u);
  const Mesh mesh = mesh_at(*c, 0, .25);
  EXPECT_LT(glm::distance(mesh.positions[0], {1, 0, .5f}), 1e-4f);
  Character fine = *c;
  subdivide(fine, .3f);
  ASSERT_GT(fine.positions.size(), 3u);
  for (const glm::vec3& p : mesh_at(fine, 0, .5).positions) EXPECT_NEAR(p.z, 1, 1e-4f);
}

// With a clip that moves node 0 by x = 0 to 4 within a second. mesh: the rest of the file
Result<Character> moved_by_a_clip(test::GltfBuffer b, const std::string& nodes,
                                  const std::string& meshes, const std::string& more = "") {
  const int times = b.floats({0, 1}, "SCALAR", 2, R"(,"min":[0],"max":[1])"),
            places = b.floats({0, 0, 0, 4, 0, 0}, "VEC3", 2);
  const test::TempFolder folder;
  const auto path = folder.path() / "thing.gltf";
  b.write(path, fmt::format(R"("scenes":[{{"nodes":[0]}}],"nodes":[{}],"meshes":[{}]{},
    "animations":[{{"name":"Go","channels":[{{"sampler":0,"target":{{"node":0,"path":"translation"}}}}],
                    "samplers":[{{"input":{},"output":{}}}]}}])",
                            nodes, meshes, more, times, places));
  return import_character(path, kGrey);
}

test::GltfBuffer one_triangle() {
  test::GltfBuffer b;
  b.floats({0, 0, 0, 1, 0, 0, 0, 1, 0}, "VEC3", 3, R"(,"min":[0,0,0],"max":[1,1,0])");
  return b;
}
constexpr const char* kOfPositions = R"({"primitives":[{"attributes":{"POSITION":0}}]})";

// The matrices may be left out: Assimp takes what is not there for some, and ends the process.
TEST(CharacterImport, ASkinWithoutMatricesStandsWhereItsJointsAre) {
  test::GltfBuffer b = one_triangle();
  b.shorts({0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0}, "VEC4", 3);
  b.floats({1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0}, "VEC4", 3);
  const auto c = moved_by_a_clip(
      b, R"({"children":[1]},{"mesh":0,"skin":0})",
      R"({"primitives":[{"attributes":{"POSITION":0,"JOINTS_0":1,"WEIGHTS_0":2}}]})",
      R"(,"skins":[{"joints":[0]}])");
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_LT(glm::distance(mesh_at(*c, 0, .5).positions[1], {3, 0, 0}), 1e-4f);
}

TEST(CharacterImport, QuantisedPositionsMoveAsOthersDo) {
  test::GltfBuffer b;
  b.shorts({0, 0, 0, 65535, 0, 0, 0, 65535, 0}, "VEC3", 3);  // of whole numbers
  const auto c = moved_by_a_clip(
      b, R"({"children":[1]},{"mesh":0,"scale":[0.0000152590,0.0000152590,0.0000152590]})",
      kOfPositions, R"(,"extensionsRequired":["KHR_mesh_quantization"])");
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_LT(glm::distance(mesh_at(*c, 0, .5).positions[1], {3, 0, 0}), 1e-3f);
}

TEST(CharacterImport, InstancesAllMove) {
  test::GltfBuffer b = one_triangle();
  b.floats({0, 0, 0, 0, 5, 0, 0, 10, 0}, "VEC3", 3);
  const auto c = moved_by_a_clip(
      b, R"({"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":1}}}})",
      kOfPositions, R"(,"extensionsUsed":["EXT_mesh_gpu_instancing"])");
  ASSERT_TRUE(c) << c.error().detail;
  const Mesh mesh = mesh_at(*c, 0, .5);
  ASSERT_EQ(mesh.positions.size(), 9u);
  EXPECT_LT(glm::distance(mesh.positions[7], {3, 10, 0}), 1e-4f);
}

// Its triangles would be seen from behind, and be black.
TEST(CharacterImport, AMirroredNodeShowsItsOutside) {
  const auto c = moved_by_a_clip(one_triangle(), R"({"children":[1]},{"mesh":0,"scale":[-1,1,1]})",
                                 kOfPositions);
  ASSERT_TRUE(c) << c.error().detail;
  const Mesh mesh = mesh_at(*c, 0, 0);
  const auto& t = mesh.triangles[0];
  const glm::vec3 a = mesh.positions[t[0]];
  EXPECT_GT(glm::cross(mesh.positions[t[1]] - a, mesh.positions[t[2]] - a).z, .5f);
}

// Its matrix comes apart into another mirror and a turn: with the clip's own keys it would stand on
// its head.
TEST(CharacterImport, AMirroredNodeThatMovesItselfStandsUpright) {
  for (const auto& [scale, at] : {std::pair{"[-1,1,1]", glm::vec3(1, 0, 0)},
                                  {"[1,1,-1]", glm::vec3(3, 0, 0)},
                                  {"[1,1,1]", glm::vec3(3, 0, 0)}}) {
    const auto c = moved_by_a_clip(one_triangle(), fmt::format(R"({{"mesh":0,"scale":{}}})", scale),
                                   kOfPositions);
    ASSERT_TRUE(c) << c.error().detail;
    const Mesh mesh = mesh_at(*c, 0, .5);
    EXPECT_LT(glm::distance(mesh.positions[1], at), 1e-4f) << scale;
    EXPECT_LT(glm::distance(mesh.positions[2], {2, 1, 0}), 1e-4f) << scale;
    const auto& t = mesh.triangles[0];
    const glm::vec3 outside = glm::normalize(glm::cross(
        mesh.positions[t[1]] - mesh.positions[t[0]], mesh.positions[t[2]] - mesh.positions[t[0]]));
    for (const glm::vec3& n : mesh.normals)
      EXPECT_LT(glm::distance(n, outside), 1e-4f) << "lit from outside: " << scale;
  }
}

// Assimp takes a white material for none.
TEST(CharacterImport, WhiteIsWhite) {
  const char* const with_material =
      R"({"primitives":[{"attributes":{"POSITION":0},"material":0}]})";
  const auto white =
      moved_by_a_clip(one_triangle(), R"({"mesh":0})", with_material,
                      R"(,"materials":[{"pbrMetallicRoughness":{"metallicFactor":0}}])");
  ASSERT_TRUE(white) << white.error().detail;
  EXPECT_EQ(white->albedo[0], (Rgb{1, 1, 1}));
  const auto none = moved_by_a_clip(one_triangle(), R"({"mesh":0})", kOfPositions);
  ASSERT_TRUE(none) << none.error().detail;
  EXPECT_EQ(none->albedo[0], kGrey);
}

// A picture that is laid otherwise than once over the first coordinates needs its material.
TEST(CharacterImport, ATransformedPictureKeepsItsMaterial) {
  // A PNG of one red pixel.
  const char* const picture =
      "data:image/"
      "png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAIAAACQd1PeAAAADElEQVR4nGP4z8AAAAMBAQDJ/"
      "pLvAAAAAElFTkSuQmCC";
  for (const auto& [how, kept] :
       {std::pair{"", false},
        {R"(,"extensions":{"KHR_texture_transform":{"offset":[0.5,0]}})", true},
        {R"(,"texCoord":1)", true}}) {
    test::GltfBuffer b = one_triangle();
    b.floats({0, 0, 1, 0, 0, 1}, "VEC2", 3);
    const auto c = moved_by_a_clip(
        b, R"({"mesh":0})",
        R"({"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1,"TEXCOORD_1":1},"material":0}]})",
        fmt::format(
            R"(,"images":[{{"uri":"{}"}}],"textures":[{{"source":0}}],"materials":[
               {{"pbrMetallicRoughness":{{"metallicFactor":0,"baseColorTexture":{{"index":0{}}}}}}}])",
            picture, how));
    ASSERT_TRUE(c) << c.error().detail;
    EXPECT_EQ(c->surface != nullptr, kept) << how;
  }
}

TEST(CharacterImport, WhatIsDamagedIsToldInOneLine) {
  const std::string node = R"({"mesh":0})";
  const auto told = [&](const Result<Character>& c) {
    return c ? std::string("read") : c.error().detail;
  };
  EXPECT_THAT(told(moved_by_a_clip(one_triangle(), R"({"mesh":0,"skin":5})", kOfPositions)),
              testing::HasSubstr("\"skin\" is 5"));
  EXPECT_THAT(
      told(moved_by_a_clip(one_triangle(), node, kOfPositions, R"(,"skins":[{"joints":[]}])")),
      testing::HasSubstr("no joints"));
  EXPECT_THAT(
      told(moved_by_a_clip(one_triangle(), node, kOfPositions, R"(,"skins":[{"joints":[7]}])")),
      testing::HasSubstr("a joint that is not there"));
  // Assimp would read a value for each time.
  test::GltfBuffer few = one_triangle();
  few.floats({0, .25f, .5f, .75f, 1}, "SCALAR", 5, R"(,"min":[0],"max":[1])");
  few.floats({0, 0, 0}, "VEC3", 1);
  const test::TempFolder folder;
  few.write(folder.path() / "few.gltf",
            fmt::format(R"("scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{}],
    "animations":[{{"channels":[{{"sampler":0,"target":{{"node":0,"path":"translation"}}}}],
                    "samplers":[{{"input":1,"output":2}}]}}])",
                        kOfPositions));
  EXPECT_THAT(told(import_character(folder.path() / "few.gltf", kGrey)),
              testing::HasSubstr("fewer values than times"));
  std::string chain = R"({"children":[1]})";
  for (int i = 1; i < 2000; ++i) chain += fmt::format(R"(,{{"children":[{}]}})", i + 1);
  EXPECT_THAT(told(moved_by_a_clip(one_triangle(), chain + "," + node, kOfPositions)),
              testing::HasSubstr("nests its nodes"));
  const std::string deep(5000, '[');
  EXPECT_THAT(told(moved_by_a_clip(one_triangle(), node, kOfPositions,
                                   R"(,"extras":)" + deep + std::string(5000, ']'))),
              testing::HasSubstr("nests its JSON"));
}

TEST(CharacterImport, AThingWithoutClipsSaysSo) {
  const test::TempFolder folder;
  const auto file = folder.path() / "plain.obj";
  std::ofstream(file) << "v 0 0 0\nv 1 0 0\nv 0 0 -1\nf 1 2 3\n";
  const auto c = import_character(file, kGrey);
  ASSERT_TRUE(c) << c.error().detail;
  EXPECT_EQ(c->bones.size(), 1u);
  const auto clip = find_clip(*c, "Walk");
  ASSERT_FALSE(clip);
  EXPECT_THAT(clip.error().detail, testing::HasSubstr("no animation"));
}

TEST(Animation, AClipIsFoundByNameOrNumber) {
  EXPECT_EQ(find_clip(animated_walker(), "Wave").value(), 1);
  EXPECT_EQ(find_clip(animated_walker(), "2").value(), 2);
  for (const char* wrong : {"Run", "3", "-1", "1x", ""}) {
    const auto clip = find_clip(animated_walker(), wrong);
    ASSERT_FALSE(clip) << wrong;
    EXPECT_THAT(clip.error().detail, testing::HasSubstr("Walk, Wave, Rest"));
  }
}

TEST(CharacterImport, RealCharactersComeWhole) {
  struct Expected {
    const char* file;
    std::size_t vertices, bones, clips;
    bool matt;  // but for a picture of its colours
  };
  for (const Expected& e : {Expected{"characters/CesiumMan.glb", 3273, 19, 1, true},
                            Expected{"characters/Fox.glb", 1728, 24, 3, false}}) {
    PENUMBRA_NEED_SHARED(path, e.file);
    const auto c = import_character(path, kGrey);
    ASSERT_TRUE(c) << c.error().detail;
    EXPECT_EQ(c->positions.size(), e.vertices);
    EXPECT_EQ(c->bones.size(), e.bones);
    EXPECT_EQ(c->clips.size(), e.clips);
    EXPECT_EQ(c->texture != nullptr, e.matt);
    EXPECT_EQ(c->tint.size(), e.matt ? e.vertices : 0);
    ASSERT_EQ(c->surface == nullptr, e.matt);
    if (!e.matt) {
      EXPECT_EQ(c->surface->material.size(), e.vertices);
      EXPECT_EQ(c->surface->coordinates[0].size(), e.vertices);
      const Material& fur = c->surface->materials[c->surface->material[0]];
      EXPECT_TRUE(fur.base_colour_map);
      EXPECT_NEAR(fur.roughness, .58f, 1e-6);
    }
    for (const Clip& clip : c->clips) {
      Mesh mesh;
      deform(*c, sample(*c, clip, .4 * clip.seconds), mesh);
      const Bounds b = bounds_of(mesh);
      EXPECT_TRUE(std::isfinite(b.low.x + b.high.x));
      EXPECT_NEAR(b.low.y / (b.high.y - b.low.y), 0, .08f) << clip.name;  // stands on its feet
    }
  }
}

}  // namespace
}  // namespace penumbra::prt
