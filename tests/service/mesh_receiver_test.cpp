// Shadows on real ground that is not a plane, against a world in which the object really stands.
#include <gtest/gtest.h>

#include <cmath>

#include "service/accuracy.h"
#include "tests/support/mesh_files.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

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

struct Case {
  const char* name;
  double bar;
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
  BakeSettings settings;
  settings.rays = settings.ground_rays = 256;
  settings.use_cache = false;
  const auto scene = prepare({{object}, {ground}}, settings,
                             [](const std::string&) { return std::function<void(double)>(); });
  ASSERT_TRUE(scene) << scene.error().detail;
  const Image<Rgb> map = std::string_view(GetParam().name) == "room"
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
  const auto ours = render_composite(in, *light, *empty);
  ASSERT_TRUE(ours);
  const Accuracy a = compare_pictures(*ours, *truth, *empty, *masks);
  const Accuracy naive = compare_pictures(*empty, *truth, *empty, *masks);
  EXPECT_LT(a.shadow_rmse, GetParam().bar);
  EXPECT_GT(naive.shadow_rmse, .1) << "without a shadow on meshes";
}

INSTANTIATE_TEST_SUITE_P(Lights, MeshReceiver, testing::Values(Case{"room", .05}, Case{"sky", .05}),
                         [](const auto& test) { return std::string(test.param.name); });

}  // namespace
}  // namespace penumbra::service
