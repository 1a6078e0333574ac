// Shadows on real ground that is not a plane, against a world in which the object really stands.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <iomanip>

#include "capture/capture.h"
#include "codec/codec.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/mesh_files.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"

namespace penumbra::runtime {

using namespace tools;
namespace {

using glm::dvec3;

// A rolling ground, 4 m wide, up to 12 cm high, normals from its own slope.
prt::Mesh make_ground() {
  constexpr int kSide = 64;
  constexpr float kWidth = 4;
  const auto height = [](float x, float z) {
    return .06f * std::sin(4 * x) * std::cos(3.3f * z) + .06f * std::sin(2.1f * z);
  };
  prt::Mesh mesh;
  for (int j = 0; j <= kSide; ++j)
    for (int i = 0; i <= kSide; ++i) {
      const float x = kWidth * (float(i) / kSide - .5f), z = kWidth * (float(j) / kSide - .5f),
                  e = .01f;
      mesh.positions.push_back({x, height(x, z), z});
      mesh.normals.push_back(
          glm::normalize(glm::vec3((height(x - e, z) - height(x + e, z)) / (2 * e), 1,
                                   (height(x, z - e) - height(x, z + e)) / (2 * e))));
      mesh.albedo.push_back({.4f, .4f, .4f});
    }
  for (std::uint32_t j = 0; j < kSide; ++j)
    for (std::uint32_t i = 0; i < kSide; ++i) {
      const std::uint32_t a = j * (kSide + 1) + i, b = a + 1, c = a + kSide + 1, d = c + 1;
      mesh.triangles.push_back({a, c, b});
      mesh.triangles.push_back({b, c, d});
    }
  return mesh;
}

// What a depth camera above the ground sees of it.
void write_depth(const std::filesystem::path& folder) {
  const prt::PinholeView v{
      320, 240, {260, 260}, {160, 120}, capture::look_at({-.4, 2.4, .9}, {0, 0, 0})};
  const auto ground = prt::RayScene::build(make_ground());
  ASSERT_TRUE(ground);
  Image<Rgb> depth(v.width, v.height);
  const glm::vec3 eye(v.world_from_camera.translation);
  for (int y = 0; y < v.height; ++y)
    for (int x = 0; x < v.width; ++x) {
      const dvec3 d((x + .5 - v.principal_px.x) / v.focal_px.x,
                    -(y + .5 - v.principal_px.y) / v.focal_px.y, -1);
      const auto hit =
          ground->intersect(eye, glm::vec3(v.world_from_camera.rotation * glm::normalize(d)), 0);
      const float along = hit ? hit->distance / static_cast<float>(glm::length(d)) : 0;
      depth.at(x, y) = {along, along, along};
    }
  ASSERT_TRUE(codec::write_hdr(folder / "depth.exr", depth, codec::Depth::kFloat));
  const glm::dmat4 m = v.world_from_camera.matrix();
  std::ofstream camera(folder / "camera.toml");
  camera
      << "version = 1\n[[camera]]\nname = \"depth\"\nrole = \"view\"\nwidth = 320\nheight = 240\n"
      << "projection = \"pinhole\"\nfocal_px = [260, 260]\nresponse = \"linear\"\n"
      << "world_from_camera = [" << std::setprecision(15);
  for (int k = 0; k < 16; ++k) camera << (k ? ", " : "") << m[k / 4][k % 4];
  camera << "]\n";
}

struct Case {
  const char* name;
  double bar;
  bool depth = false;
};

class MeshReceiver : public testing::TestWithParam<Case> {};

TEST_P(MeshReceiver, ShadowOnUnevenGroundFollowsTheReference) {
  const test::TempFolder folder;
  test::write_obj(make_ground(), folder.path() / "ground.obj");
  SceneObject object;
  object.asset = "builtin:twist";
  object.name = "twist";
  object.position = {0, .1, 0};
  object.albedo = {.6f, .6f, .6f};
  RealGeometry ground;
  ground.mesh = (folder.path() / "ground.obj").string();
  ground.albedo = Rgb{.4f, .4f, .4f};
  constexpr int kRays = 256;
  const auto scene = test::prepared({{object}, {ground}}, kRays);
  ASSERT_TRUE(scene) << scene.error().detail;
  // The world is the mesh; ours may know it from a depth picture alone.
  std::optional<PreparedScene> seen;
  if (GetParam().depth) {
    write_depth(folder.path());
    RealGeometry surface;
    surface.depth = (folder.path() / "depth.exr").string();
    surface.camera = (folder.path() / "camera.toml").string();
    surface.albedo = ground.albedo;
    auto from_depth = test::prepared({{object}, {surface}}, kRays);
    ASSERT_TRUE(from_depth) << from_depth.error().where << from_depth.error().detail;
    seen = std::move(*from_depth);
  }
  const Image<Rgb> map = std::string_view(GetParam().name).starts_with("room")
                             ? capture::make_room_environment(256, 128)
                             : capture::make_sky_environment(512, 256, .8);
  const auto light = lighting::estimate_map(map, {5, {}});
  ASSERT_TRUE(light);
  const prt::PinholeView view{
      112, 84, {105, 105}, {56, 42}, capture::look_at({.5, 1.3, 1.6}, {0, .2, 0})};
  const StillScene in{&*scene, &map, view};
  const auto masks = make_masks(*scene, view);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks) << masks.error().detail;
  const auto empty = render_real(in, .012, {});
  const auto truth = render_reference(in, true, .012, std::nullopt, {});
  ASSERT_TRUE(empty);
  ASSERT_TRUE(truth);
  const auto ours = render_composite({seen ? &*seen : &*scene, &map, view}, *light, *empty);
  ASSERT_TRUE(ours);
  const Accuracy a = compare_pictures(*ours, *truth, *empty, *masks);
  const Accuracy naive = compare_pictures(*empty, *truth, *empty, *masks);
  std::printf("%s: shadow %.4f\n", GetParam().name, a.shadow_rmse);
  EXPECT_LT(a.shadow_rmse, GetParam().bar);
  EXPECT_GT(naive.shadow_rmse, .1) << "without a shadow on meshes";
}

INSTANTIATE_TEST_SUITE_P(Lights, MeshReceiver,
                         testing::Values(Case{"room", .05}, Case{"sky", .05},
                                         Case{"room_by_depth", .05, true},
                                         Case{"sky_by_depth", .05, true}),
                         [](const auto& test) { return std::string(test.param.name); });

}  // namespace
}  // namespace penumbra::runtime
