// Scenes that no one would set up on purpose: every pixel stays finite, and what cannot be seen
// changes nothing.
#include <gtest/gtest.h>

#include <cmath>

#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tools/pictures/still.h"

namespace penumbra::runtime {

using namespace tools;
namespace {

using glm::dvec3;

constexpr int kOddWidth = 160, kOddHeight = 120;

Pose looking(const dvec3& eye, const dvec3& target) {
  return capture::look_at(eye, target);
}

struct OddScene {
  PreparedScene scene;
  prt::PinholeView view{
      kOddWidth, kOddHeight, {150, 150}, {80, 60}, looking({.3, 1.1, 2.2}, {0, .2, 0})};
  lighting::LightEstimate light;

  explicit OddScene(prt::Mesh mesh = prt::make_sphere({0, .3f, 0}, .3f, 3, {.6f, .5f, .4f})) {
    prt::BakeOptions bake;
    bake.rays = bake.ground_rays = 64;
    bake.bounces = 1;
    bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
    auto baked = prt::bake(std::move(mesh), bake);
    EXPECT_TRUE(baked) << baked.error().detail;
    scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, {.4f, .4f, .4f}, {}});
    if (baked) scene.objects.push_back({"odd", std::move(*baked), {}, 0, nullptr});
    light.valid = true;
    RadianceSh sky(5);
    sky[0] = {3, 3, 3};
    sky[1] = {1, 1, 1};
    light.light = light.upper_hemisphere_light = sky;
    light.mean_radiance = {.85f, .85f, .85f};
    light.lights.push_back(sun({.5, .7, .4}));
  }
  static lighting::DistantLight sun(const dvec3& towards) {
    lighting::DistantLight d;
    d.id = 1;
    d.direction = glm::normalize(towards);
    d.radius = Radians(.01);
    d.radiance = {6000, 5600, 5000};
    return d;
  }
};

Still picture() {
  Still real;
  real.radiance = Image<Rgb>(kOddWidth, kOddHeight);
  for (int y = 0; y < kOddHeight; ++y)
    for (int x = 0; x < kOddWidth; ++x)
      real.radiance.at(x, y) = {.2f + .001f * static_cast<float>(x), .3f,
                                .1f + .002f * static_cast<float>(y)};
  return real;
}

struct Seen {
  Image<Rgb> pixels;
  std::size_t changed = 0;
};

// Composites and looks at every pixel.
std::optional<Seen> look(const OddScene& s) {
  const Still real = picture();
  const Image<Rgb> none;
  auto pipeline = make_still_pipeline(s.scene, s.view, {});
  if (!pipeline) {
    EXPECT_EQ(pipeline.error().code, ErrorCode::kUnavailable) << pipeline.error().detail;
    return std::nullopt;
  }
  auto still = composite_still(*pipeline, s.view, s.light, real);
  EXPECT_TRUE(still) << still.error().detail;
  if (!still) return std::nullopt;
  Seen out{std::move(still->radiance), 0};
  for (std::size_t i = 0; i < out.pixels.area(); ++i) {
    const Rgb& c = out.pixels.pixels()[i];
    EXPECT_TRUE(is_finite(c) && c.r >= 0 && c.g >= 0 && c.b >= 0) << "pixel " << i;
    out.changed += c == real.radiance.pixels()[i] ? 0u : 1u;
  }
  return out;
}

#define LOOK(name, scene)        \
  const auto name = look(scene); \
  if (!name) GTEST_SKIP() << "no OpenGL ES 3.1 here"

TEST(OddScene, PlainOneForComparison) {
  const OddScene s;
  LOOK(seen, s);
  EXPECT_GT(seen->changed, 1000u);
}

TEST(OddScene, ReceiverEdgeOn) {
  OddScene s;
  s.view.world_from_camera = looking({0, 0, 2}, {0, 0, 0});  // in the floor itself
  LOOK(seen, s);
  EXPECT_GT(seen->changed, 100u) << "the object stands up from the edge";
  s.view.world_from_camera = looking({0, 1e-7, 2}, {0, 1e-7, 0});
  LOOK(upper_moments, s);
  EXPECT_GT(upper_moments->changed, 100u);
}

TEST(OddScene, CameraUnderTheFloorSeesNoShadow) {
  OddScene s;
  s.view.world_from_camera = looking({.3, -1, 2}, {0, -.2, 0});
  LOOK(seen, s);
  OddScene without = s;
  without.light.lights.clear();
  LOOK(dim, without);
  // The sphere may show; the floor's underside must not darken.
  for (int x = 0; x < kOddWidth; ++x)
    EXPECT_EQ(seen->pixels.at(x, kOddHeight - 1), dim->pixels.at(x, kOddHeight - 1)) << x;
}

TEST(OddScene, ObjectBelowTheFloorIsHiddenByIt) {
  OddScene s;
  s.scene.objects[0].world_from_bake.translation = {0, -2, 0};
  s.scene.objects[0].baked.receiver.reset();  // as prepare() does: it stands on nothing
  LOOK(buried, s);
  EXPECT_EQ(buried->changed, 0u);
  const OddScene standing, half(prt::make_sphere({0, .05f, 0}, .3f, 3, {.6f, .5f, .4f}));
  LOOK(whole, standing);
  LOOK(part, half);
  EXPECT_GT(part->changed, 100u);
  EXPECT_LT(part->changed, whole->changed);
}

TEST(OddScene, ObjectOutsideTheViewChangesNothing) {
  OddScene s;
  s.scene.objects[0].world_from_bake.translation = {60, 0, 40};
  LOOK(beside, s);
  EXPECT_EQ(beside->changed, 0u);
  s.scene.objects[0].world_from_bake.translation = {0, 0, 30};  // behind the camera
  LOOK(behind, s);
  EXPECT_EQ(behind->changed, 0u);
}

TEST(OddScene, CameraInsideTheObject) {
  OddScene s;
  s.view.world_from_camera = looking({0, .3, 0}, {0, .3, -1});
  LOOK(seen, s);
}

TEST(OddScene, LightAtTheNadirLightsNoFloor) {
  OddScene s;
  s.light.lights[0] = OddScene::sun({0, -1, 0});
  OddScene without = s;
  without.light.lights.clear();
  LOOK(with_distant_light, s);
  LOOK(none, without);
  double worst = 0;
  for (std::size_t i = 0; i < none->pixels.area(); ++i)
    worst = std::max(worst, double(std::abs(luminance(with_distant_light->pixels.pixels()[i]) -
                                            luminance(none->pixels.pixels()[i]))));
  EXPECT_LT(worst, 2e-3) << "the floor stands between";
}

TEST(OddScene, LightOnTheHorizonAndAtTheZenith) {
  for (const dvec3 towards :
       {dvec3(1, 0, 0), dvec3(1, 1e-9, 0), dvec3(1, 1e-3, 0), dvec3(0, 1, 0), dvec3(1e-12, 1, 0)}) {
    OddScene s;
    s.light.lights[0] = OddScene::sun(towards);
    LOOK(seen, s);
    EXPECT_GT(seen->changed, 500u);
  }
}

TEST(OddScene, LightsWithoutSizeOrPower) {
  OddScene s;
  s.light.lights[0].radius = Radians(0);
  LOOK(point, s);
  s.light.lights[0].radius = Radians(.01);
  s.light.lights[0].radiance = {};
  LOOK(dark, s);
}

TEST(OddScene, ObjectWithoutVolume) {
  prt::Mesh quad;
  quad.positions = {{-.3f, .2f, 0}, {.3f, .2f, 0}, {.3f, .8f, 0}, {-.3f, .8f, 0}};
  quad.normals.assign(4, {0, 0, 1});
  quad.albedo.assign(4, {.5f, .5f, .5f});
  quad.triangles = {{0, 1, 2}, {0, 2, 3}};
  OddScene upright(quad);
  LOOK(seen, upright);
  EXPECT_GT(seen->changed, 200u);
  for (glm::vec3& p : quad.positions) p = {p.x, 0, p.y - .5f};  // a decal on the floor
  quad.normals.assign(4, {0, 1, 0});
  OddScene flat(quad);
  LOOK(decal, flat);
}

TEST(OddScene, ObjectSmallerThanAPixelAndLargerThanTheView) {
  OddScene small(prt::make_sphere({0, 1e-4f, 0}, 1e-4f, 1, {.5f, .5f, .5f}));
  LOOK(dot, small);
  OddScene large(prt::make_sphere({0, 400, -500}, 400, 3, {.5f, .5f, .5f}));
  LOOK(wall, large);
}

TEST(OddScene, EnvironmentsThatAreNoLight) {
  Image<Rgb> map(64, 32);
  const auto black = lighting::estimate_map(map, {});
  ASSERT_TRUE(black) << "darkness is a light";
  EXPECT_TRUE(black->lights.empty());
  OddScene s;
  s.light = *black;
  LOOK(dark, s);
  for (const float bad : {std::nanf(""), HUGE_VALF, -HUGE_VALF}) {
    map.at(5, 7).g = bad;
    const auto refused = lighting::estimate_map(map, {});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kNonFinite);
  }
}

}  // namespace
}  // namespace penumbra::runtime
