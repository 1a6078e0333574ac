#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <glm/geometric.hpp>
#include <set>
#include <string>
#include <string_view>

#include "prt/geometry/material.h"
#include "prt/prt.h"
#include "tests/support/gltf_maker.h"
#include "tests/support/shared_data.h"
#include "tests/support/temp_folder.h"

namespace penumbra::prt {
namespace {

namespace fs = std::filesystem;

constexpr Rgb kDefault{.7f, .6f, .5f};
constexpr const char* kTriangle = "v 0 0 0\nv 1 0 0\nv 0 0 -1\nf 1 2 3\n";  // faces up

constexpr const char* kPly =
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float "
    "z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 0 -1\n3 0 1 2\n";

// One triangle (0,0,0) (1,0,0) (0,1,0) under these nodes.
std::string gltf(std::string nodes, std::string of_primitive = "", std::string more = "") {
  if (!of_primitive.empty()) of_primitive = "," + of_primitive;
  return R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":)" + nodes + "," +
         more + R"("meshes":[{"primitives":[{"attributes":{"POSITION":0})" + of_primitive + R"(}]}],
    "accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3,
                  "min":[0,0,0],"max":[1,1,0]}],
    "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":
    "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]})";
}

class ImportMesh : public testing::Test {
 protected:
  fs::path put(const char* name, std::string_view text) const {
    const fs::path path = folder_.path() / name;
    std::ofstream(path, std::ios::binary) << text;
    return path;
  }
  Import imported(const char* name, std::string_view text) const {
    auto result = import_mesh(put(name, text), kDefault);
    EXPECT_TRUE(result) << (result ? "" : result.error().detail);
    return result ? *result : Import{};
  }
  Error error_of(const char* name, std::string_view text) const {
    const fs::path path = put(name, text);
    const auto result = import_mesh(path, kDefault);
    EXPECT_FALSE(result) << name;
    if (result) return {};
    EXPECT_EQ(result.error().where, path.string());
    EXPECT_FALSE(result.error().detail.empty());
    return result.error();
  }

  test::TempFolder folder_;
};

float area_of(const Mesh& mesh) {
  float area = 0;
  for (const auto& t : mesh.triangles)
    area += .5f * glm::length(glm::cross(mesh.positions[t[1]] - mesh.positions[t[0]],
                                         mesh.positions[t[2]] - mesh.positions[t[0]]));
  return area;
}

void expect_sound(const Mesh& mesh) {
  ASSERT_EQ(mesh.normals.size(), mesh.positions.size());
  ASSERT_EQ(mesh.albedo.size(), mesh.positions.size());
  std::set<std::uint32_t> used;
  for (const auto& t : mesh.triangles)
    for (const auto i : t) {
      ASSERT_LT(i, mesh.positions.size());
      used.insert(i);
    }
  EXPECT_EQ(used.size(), mesh.positions.size())
      << "vertices without a triangle would be baked for nothing";
  for (const glm::vec3& n : mesh.normals) ASSERT_NEAR(glm::length(n), 1, 1e-5);
}

// ------------------------------------------------------------------------------------- geometry

TEST_F(ImportMesh, QuadsAreCutIntoTrianglesOfTheSameSurface) {
  const Import import = imported("quad.obj", "v 0 0 0\nv 2 0 0\nv 2 0 -3\nv 0 0 -3\nf 1 2 3 4\n");
  expect_sound(import.mesh);
  EXPECT_EQ(import.mesh.triangles.size(), 2u);
  EXPECT_EQ(import.degenerate_triangles, 0u);
  EXPECT_NEAR(area_of(import.mesh), 6, 1e-5);
  for (const auto& t : import.mesh.triangles) {
    const auto& p = import.mesh.positions;
    EXPECT_GT(glm::cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]).y, 0) << "the winding is kept";
  }
}

TEST_F(ImportMesh, MissingNormalsAreMadeOutward) {
  const Mesh sphere = make_sphere({1, 2, 3}, .5f, 3, kDefault);
  std::string text;
  for (const glm::vec3& p : sphere.positions)
    text +=
        "v " + std::to_string(p.x) + ' ' + std::to_string(p.y) + ' ' + std::to_string(p.z) + '\n';
  for (const auto& t : sphere.triangles) {
    text += 'f';
    for (const auto i : t) text += ' ' + std::to_string(i + 1);
    text += '\n';
  }
  const Mesh mesh = imported("sphere.obj", text).mesh;
  expect_sound(mesh);
  EXPECT_EQ(mesh.positions.size(), sphere.positions.size()) << "neighbours share their vertices";
  EXPECT_EQ(mesh.triangles.size(), sphere.triangles.size());
  for (std::size_t i = 0; i < mesh.positions.size(); ++i)
    EXPECT_GT(glm::dot(mesh.normals[i], glm::normalize(mesh.positions[i] - glm::vec3(1, 2, 3))),
              .999f);
}

// A tetrahedron whose triangles face inwards: it would be drawn black.
TEST_F(ImportMesh, AClosedMeshThatIsInsideOutCanBeTurnedRound) {
  const std::string points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
  const auto volume = [](const Mesh& m) {
    double sum = 0;
    for (const auto& t : m.triangles)
      sum += glm::dot(glm::dvec3(m.positions[t[0]]),
                      glm::cross(glm::dvec3(m.positions[t[1]]), glm::dvec3(m.positions[t[2]])));
    return sum / 6;
  };
  Import inside_out = imported("in.obj", points + "f 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n");
  EXPECT_NEAR(volume(inside_out.mesh), -1. / 6, 1e-6);
  EXPECT_TRUE(turn_outwards(inside_out.mesh));
  EXPECT_NEAR(volume(inside_out.mesh), 1. / 6, 1e-6);
  for (const auto& t : inside_out.mesh.triangles) {
    const auto& p = inside_out.mesh.positions;
    const glm::vec3 across = glm::cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]);
    EXPECT_GT(glm::dot(across, inside_out.mesh.normals[t[0]]), 0);
  }
  Import right = imported("out.obj", points + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
  EXPECT_FALSE(turn_outwards(right.mesh));
  EXPECT_NEAR(volume(right.mesh), 1. / 6, 1e-6);
  // Without a side it is open: which way was meant nobody can tell.
  Import open = imported("open.obj", points + "f 1 2 3\nf 1 4 2\nf 1 3 4\n");
  EXPECT_FALSE(turn_outwards(open.mesh));
}

TEST_F(ImportMesh, GivenNormalsAreKept) {
  const Mesh mesh =
      imported("n.obj", "v 0 0 0\nv 1 0 0\nv 0 0 -1\nvn 0 .8 .6\nf 1//1 2//1 3//1\n").mesh;
  expect_sound(mesh);
  for (const glm::vec3& n : mesh.normals)
    EXPECT_LT(glm::distance(n, glm::vec3(0, .8f, .6f)), 1e-5f);
}

TEST_F(ImportMesh, DegenerateTrianglesAreDroppedAndCounted) {
  const Import import = imported("d.obj", std::string(kTriangle) +
                                              "v 2 0 0\nv 3 0 0\nv 4 0 0\n"
                                              "f 4 5 6\n"             // on one line
                                              "f 1 2 2\n"             // two corners are one
                                              "v 1 0 0\nf 2 3 7\n");  // two corners at one place
  expect_sound(import.mesh);
  EXPECT_EQ(import.mesh.triangles.size(), 1u);
  EXPECT_EQ(import.degenerate_triangles, 3u);
  EXPECT_NEAR(area_of(import.mesh), .5, 1e-6);
}

TEST_F(ImportMesh, SizeDoesNotMakeATriangleDegenerate) {
  for (const char* edge : {"1e-6", "1e-3", "1", "1e6"}) {
    const std::string e = edge;
    const Import import =
        imported("s.obj", "v 0 0 0\nv " + e + " 0 0\nv 0 0 -" + e + "\nf 1 2 3\n");
    EXPECT_EQ(import.mesh.triangles.size(), 1u) << edge;
    EXPECT_EQ(import.degenerate_triangles, 0u) << edge;
  }
}

TEST_F(ImportMesh, NodesOfAGltfPlaceTheirMeshes) {
  const Mesh mesh = imported("t.gltf", gltf(R"([{"translation":[0,0,5],"children":[1]},
                                                {"scale":[2,2,2],"mesh":0}])"))
                        .mesh;
  expect_sound(mesh);
  const Bounds b = bounds_of(mesh);
  EXPECT_LT(glm::distance(b.low, glm::vec3(0, 0, 5)), 1e-5f);
  EXPECT_LT(glm::distance(b.high, glm::vec3(2, 2, 5)), 1e-5f);
  for (const glm::vec3& n : mesh.normals) EXPECT_LT(glm::distance(n, glm::vec3(0, 0, 1)), 1e-5f);
}

// ------------------------------------------------------------------------------------- albedo

TEST_F(ImportMesh, WithoutMaterialTheDefaultAlbedoHolds) {
  const std::string stl =
      "solid a\nfacet normal 0 1 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 0 -1\n"
      "endloop\nendfacet\nendsolid a\n";
  for (const auto& [name, text] : {std::pair<const char*, std::string>{"t.obj", kTriangle},
                                   {"t.ply", kPly},
                                   {"t.stl", stl},
                                   {"t.gltf", gltf(R"([{"mesh":0}])")}}) {
    const Mesh mesh = imported(name, text).mesh;
    expect_sound(mesh);
    ASSERT_EQ(mesh.positions.size(), 3u) << name;
    EXPECT_EQ(mesh.albedo[0], kDefault) << name;
  }
}

TEST_F(ImportMesh, MaterialGivesTheAlbedo) {
  put("m.mtl", "newmtl red\nKd .8 .1 .2\n");
  const Mesh obj = imported("m.obj", "mtllib m.mtl\nusemtl red\n" + std::string(kTriangle)).mesh;
  // A material without a name is one all the same.
  const Mesh nameless =
      imported("m.gltf", gltf(R"([{"mesh":0}])", R"("material":0)", R"("materials":
      [{"pbrMetallicRoughness":{"baseColorFactor":[0.8,0.1,0.2,1],
        "metallicFactor":0}}],)"))
          .mesh;
  for (const Mesh* mesh : {&obj, &nameless}) {
    ASSERT_EQ(mesh->albedo.size(), 3u);
    for (const Rgb& a : mesh->albedo)
      for (int c = 0; c < 3; ++c) EXPECT_NEAR(a[c], (Rgb{.8f, .1f, .2f})[c], 1e-6);
  }
}

TEST_F(ImportMesh, AlbedoStaysBetweenZeroAndOne) {
  put("m.mtl", "newmtl odd\nKd 7 -1 .5\n");
  const Mesh odd = imported("m.obj", "mtllib m.mtl\nusemtl odd\n" + std::string(kTriangle)).mesh;
  const Mesh coloured =
      imported("c.ply",
               "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
               "property float z\nproperty float red\nproperty float green\n"
               "property float blue\nelement face 1\n"
               "property list uchar int vertex_indices\nend_header\n"
               "0 0 0 9 -3 .5\n1 0 0 9 -3 .5\n0 0 -1 nan .5 .5\n3 0 1 2\n")
          .mesh;
  for (const Mesh* mesh : {&odd, &coloured})
    for (const Rgb& a : mesh->albedo)
      for (int c = 0; c < 3; ++c) EXPECT_TRUE(a[c] >= 0 && a[c] <= 1) << a[c];
}

// ------------------------------------------------------------------------------------- pictures

constexpr const char* kTexturedTriangle =
    "mtllib m.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 0 -1\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";

TEST_F(ImportMesh, ThePictureOfAnObjIsDrawnAndItsMeanIsTheAlbedo) {
  put("m.mtl", "newmtl m\nKd .5 .5 .5\nmap_Kd a.png\n");
  const auto png = test::encoded(Image<Rgba8>(4, 4, {255, 255, 0, 255}), ".png");
  put("a.png", {reinterpret_cast<const char*>(png.data()), png.size()});
  const Import import = imported("m.obj", kTexturedTriangle);
  ASSERT_TRUE(import.surface);
  ASSERT_EQ(import.surface->materials.size(), 1u);
  const Material& m = import.surface->materials[0];
  EXPECT_EQ(m.name, "m");
  EXPECT_EQ(m.roughness, 1);
  EXPECT_EQ(m.metallic, 0);
  EXPECT_NEAR(m.base_colour.r, .5f, 1e-6);
  EXPECT_EQ(m.base_colour_map.picture->codes.at(3, 3), (Rgba8{255, 255, 0, 255}));
  for (std::size_t i = 0; i < import.mesh.positions.size(); ++i) {
    const glm::vec3& p = import.mesh.positions[i];
    EXPECT_EQ(import.surface->coordinates[0][i], glm::vec2(p.x, 1 + p.z)) << "v points down";
    EXPECT_NEAR(import.mesh.albedo[i].r, .5f, 1e-6);
    EXPECT_NEAR(import.mesh.albedo[i].b, 0, 1e-6);
  }
}

TEST_F(ImportMesh, APictureThatCannotBeReadIsSaid) {
  fs::create_directory(folder_.path() / "sub");
  put("outside.png", "");
  for (const char* name : {"absent.png", "../outside.png", "/etc/hostname"}) {
    put("sub/m.mtl", std::string("newmtl m\nKd .5 .5 .5\nmap_Kd ") + name + "\n");
    const Import import = imported("sub/m.obj", kTexturedTriangle);
    EXPECT_FALSE(import.surface) << name;
    ASSERT_EQ(import.left_out.size(), 1u) << name;
    EXPECT_NE(import.left_out[0].find(name), std::string::npos) << import.left_out[0];
  }
}

// ------------------------------------------------------------------------------------- errors

TEST_F(ImportMesh, MissingFileIsNotFound) {
  const auto result = import_mesh(folder_.path() / "absent.obj", kDefault);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kNotFound);
  EXPECT_EQ(result.error().where, (folder_.path() / "absent.obj").string());
  EXPECT_FALSE(import_mesh(folder_.path(), kDefault)) << "a folder";
}

TEST_F(ImportMesh, OnlyDegenerateTrianglesAreAnError) {
  const Error error = error_of("d.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 2 2\n");
  EXPECT_EQ(error.code, ErrorCode::kInvalid);
  EXPECT_NE(error.detail.find("degenerate"), std::string::npos);
}

TEST_F(ImportMesh, FilesWithoutTrianglesAreErrors) {
  for (const auto& [name, text] : {std::pair{"empty.obj", ""},
                                   {"empty.ply", ""},
                                   {"empty.glb", ""},
                                   {"empty.gltf", "{}"},
                                   {"points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"},
                                   {"lines.obj", "v 0 0 0\nv 1 0 0\nl 1 2\n"}}) {
    const Error error = error_of(name, text);
    EXPECT_TRUE(error.code == ErrorCode::kInvalid || error.code == ErrorCode::kUnreadable) << name;
  }
}

// Assimp would give one triangle of a strip and say nothing.
TEST_F(ImportMesh, NumbersOfAnObjMayBeginWithTheirPoint) {
  put("point.mtl", "newmtl .5\nKd .25 .5 .125\n");
  const Import got = imported(
      "point.obj", "mtllib point.mtl\nusemtl .5\nv .0 .0 0\nv +.5 0 -.0\nv 0\t0 -.25\nf 1 2 3\n");
  ASSERT_EQ(got.mesh.triangles.size(), 1u);
  std::vector<float> xz;
  for (const glm::vec3& p : got.mesh.positions) xz.push_back(p.x), xz.push_back(p.z);
  EXPECT_EQ(xz, (std::vector<float>{0, 0, .5f, 0, 0, -.25f}));
  EXPECT_NEAR(got.mesh.albedo[0].r, .25f, 1e-6f);
  EXPECT_NEAR(got.mesh.albedo[0].b, .125f, 1e-6f);
}

TEST_F(ImportMesh, TriangleStripsAreRefusedByName) {
  const auto strips =
      import_mesh(put("strips.ply",
                      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float "
                      "y\nproperty float z\nelement tristrips 1\nproperty list int int "
                      "vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 -1\n1 0 -1\n4 0 1 2 3\n"),
                  kDefault);
  ASSERT_FALSE(strips);
  EXPECT_EQ(strips.error().code, ErrorCode::kInvalid);
  EXPECT_NE(strips.error().detail.find("strips"), std::string::npos);
}

TEST_F(ImportMesh, NonFiniteVertexIsNamed) {
  for (const char* bad : {"nan", "inf", "-inf"}) {
    const Error error =
        error_of("n.obj", "v 0 0 0\nv 1 0 0\nv 0 " + std::string(bad) + " -1\nf 1 2 3\n");
    EXPECT_EQ(error.code, ErrorCode::kNonFinite) << bad;
    EXPECT_NE(error.detail.find("vertex 2"), std::string::npos) << error.detail;
  }
}

TEST_F(ImportMesh, OtherFilesAreUnreadable) {
  for (const char* name :
       {"text.obj", "text.ply", "text.glb", "text.gltf", "text.fbx", "text.unknown"}) {
    const Error error =
        error_of(name, "It was a dark and stormy night; no triangle was in sight.\n");
    EXPECT_TRUE(error.code == ErrorCode::kInvalid || error.code == ErrorCode::kUnreadable) << name;
    EXPECT_EQ(error.detail.find('\n'), std::string::npos) << "errors are printed as one line";
  }
}

using ImportMeshDeathTest = ImportMesh;

TEST_F(ImportMeshDeathTest, DamagedFilesEndInAnErrorAndInFiniteTime) {
  const std::string ply = kPly;
  const std::pair<const char*, std::string> cases[] = {
      {"in the header.ply", ply.substr(0, 45)},
      {"in the properties.ply", ply.substr(0, 90)},
      {"in the vertices.ply", ply.substr(0, ply.size() - 20)},
      {"in the face.ply", ply.substr(0, ply.size() - 2)},
      {"without its end.ply",
       ply.substr(0, ply.find("end_header")) + "end\n0 0 0\n1 0 0\n0 0 -1\n3 0 1 2\n"},
      {"in the counts.off", "OFF\n3 1 "},
      {"in the vertices.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n"},
      {"with an odd face.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 0 -1\n0\n"}};
  for (const auto& [name, text] : cases) {
    const fs::path path = put(name, text);
    // In a process of its own: a reader that never returns can only be killed.
    EXPECT_EXIT(
        {
          ::alarm(3);
          const auto result = import_mesh(path, kDefault);
          std::_Exit(result ? 1 : 0);
        },
        testing::ExitedWithCode(0), "")
        << name;
  }
}

TEST_F(ImportMesh, IndexOfAVertexThatIsNotThereNeverReachesTheMesh) {
  const auto result = import_mesh(put("i.obj", std::string(kTriangle) + "f 1 2 9\n"), kDefault);
  if (result) expect_sound(result->mesh);  // dropped or refused, both are sound
}

// ------------------------------------------------------------------------------------- shared data

TEST_F(ImportMesh, BunnyKeepsItsFacesAndTheVerticesTheyUse) {
  PENUMBRA_NEED_SHARED(path, "eval-only/meshes/stanford-bunny.obj");
  const auto result = import_mesh(path, kDefault);
  ASSERT_TRUE(result) << result.error().detail;
  expect_sound(result->mesh);
  EXPECT_EQ(result->mesh.triangles.size() + result->degenerate_triangles, 69451u);
  // Of the file's 35947 vertices the faces use 34834; sharp creases split a few.
  EXPECT_GE(result->mesh.positions.size(), 34834u);
  EXPECT_LE(result->mesh.positions.size(), 35947u);
  EXPECT_EQ(result->degenerate_triangles, 0u);
  EXPECT_NEAR(radius_around(result->mesh, bounds_of(result->mesh).centre()), .1, .03) << "metres";
}

}  // namespace
}  // namespace penumbra::prt
