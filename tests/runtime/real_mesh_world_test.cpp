#include "runtime/studio/internal/real_mesh_world.h"
#include "capture/capture.h"
#include "prt/prt.h"
#include "runtime/direct/real_surface_stage.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/conventions.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {
namespace {

using glm::dvec3;

const dvec3 kEye{.6, .7, 1.4}, kPlace{0, 0, -.1};

struct Studio {
  std::shared_ptr<const capture::FloorWorld> floor;
  std::shared_ptr<const RealMeshWorld> furnished;
  prt::Mesh box;
};

Studio make_studio(const Image<Rgb>& map, const dvec3& place = kPlace) {
  Studio s;
  s.floor = *capture::FloorWorld::make(map);
  s.box = load_asset("builtin:box", {.5f, .4f, .3f}, 0)->mesh;
  prt::transform(s.box, Pose{{1, 0, 0, 0}, place}.matrix());
  auto furnished = RealMeshWorld::make(s.floor, s.box, {});
  EXPECT_TRUE(furnished) << furnished.error().detail;
  s.furnished = *furnished;
  return s;
}

dvec3 towards(const dvec3& point) {
  return glm::normalize(point - kEye);
}

// The same world as the path tracer sees it, at places on the floor and on the box.
TEST(RealMeshWorld, LightIsThatOfThePathTracer) {
  const Studio s = make_studio(capture::make_room_environment(512, 256));
  const auto far = prt::EnvironmentLight::from_map(s.floor->environment());
  ASSERT_TRUE(far);
  const prt::ReferenceWorld world{
      s.box, {{{0, 0, 0}, {0, 1, 0}, s.floor->mean_floor_albedo(), {}}}, &*far, {}};
  std::vector<prt::IrradiancePoint> points;
  for (const double x : {-.35, -.2, .22, .3, .5}) points.push_back({{x, 0, .05}, {0, 1, 0}});
  for (const double y : {.05, .2, .35}) points.push_back({{.05, y, .03}, {0, 0, 1}});
  points.push_back({{.05, .4, -.1}, {0, 1, 0}});
  const auto truth = prt::reference_irradiance(world, points, 8192, 77);
  ASSERT_TRUE(truth);
  double darkest = 1;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const dvec3 at = points[i].position;
    const Rgb albedo = points[i].position.y > 0 ? Rgb{.5f, .4f, .3f} : s.floor->floor_albedo(at);
    const Rgb expected = albedo * (*truth)[i] * static_cast<float>(1 / kPi);
    const Rgb seen = s.furnished->radiance(kEye, towards(at));
    EXPECT_NEAR(luminance(seen) / luminance(expected), 1, .03)
        << at.x << ' ' << at.y << ' ' << at.z;
    if (at.y == 0) darkest = std::min(darkest, double(luminance(s.furnished->floor_fraction(at))));
  }
  EXPECT_LT(darkest, .85) << "a place in the shadow";
}

TEST(RealMeshWorld, FarAwayNothingChanges) {
  const Studio s = make_studio(capture::make_sky_environment(256, 128, .8));
  const dvec3 up = glm::normalize(dvec3(.2, .5, -1)), beside{3, 0, 2};
  EXPECT_EQ(s.furnished->radiance(kEye, up), s.floor->radiance(kEye, up));
  EXPECT_EQ(s.furnished->far_radiance(towards(kPlace)), s.floor->far_radiance(towards(kPlace)));
  EXPECT_EQ(s.furnished->radiance(kEye, towards(beside)), s.floor->radiance(kEye, towards(beside)));
  EXPECT_NE(s.furnished->radiance(kEye, towards(kPlace + dvec3(0, .2, 0))),
            s.floor->radiance(kEye, towards(kPlace + dvec3(0, .2, 0))));
}

// The lower hemisphere of this map is bright: it must not shine past the floor onto what stands on
// it, nor darken what reaches below it.
TEST(RealMeshWorld, FootOfAThingIsLitAsWhatStandsJustAboveTheFloor) {
  Image<Rgb> map(64, 32, {1, 1, 1});
  for (int y = 16; y < 32; ++y) std::ranges::fill(map.row(y), Rgb{6, 6, 6});
  for (const double lift : {0., -.15}) {
    const Studio s = make_studio(map, kPlace + dvec3(0, lift, 0));
    const auto wall = [&](double y) {
      return luminance(s.furnished->radiance(kEye, towards({.05, y, .03})));
    };
    for (const double y : {.0005, .002, .005})
      EXPECT_NEAR(wall(y) / wall(.02), 1, .12) << lift << ' ' << y;
  }
}

// What covers the floor leaves no dark seam where it stands.
TEST(RealMeshWorld, ContactIsNoBlackLine) {
  const Studio s = make_studio(capture::make_sky_environment(256, 128, 1.2));
  const Rgb near = s.furnished->floor_fraction({.05, 0, .034}),
            further = s.furnished->floor_fraction({.05, 0, .06});
  EXPECT_GT(luminance(near), .5f * luminance(further));
}

TEST(RealMeshWorld, NothingToStandThereIsRefused) {
  const auto floor = *capture::FloorWorld::make(capture::make_sky_environment(64, 32, 1));
  const auto world = RealMeshWorld::make(floor, {}, {});
  ASSERT_FALSE(world);
  EXPECT_EQ(world.error().code, ErrorCode::kInvalid);
}

// What vertices of a real mesh count for beside the floor, in a pixel that shows both.
TEST(WeightsBeside, AreOfThePlaneOrOfTheMeanAndNeverOutOfRange) {
  const std::vector<Rgb> exit = {{.4f, .2f, .1f}, {}, {1e9f, .2f, .1f}};
  const auto beside = weights_beside({.2f, .2f, 0}, exit);
  EXPECT_NEAR(beside[0].r, 2, 1e-5);
  EXPECT_NEAR(beside[0].g, 1, 1e-5);
  EXPECT_FLOAT_EQ(beside[1].g, .01f) << "black";
  EXPECT_FLOAT_EQ(beside[2].r, 100) << "a lamp";
  EXPECT_NEAR(beside[0].b, .1f / (luminance({.2f, .2f, 0}) / 100), .1) << "a plane without blue";
  const std::vector<Rgb> even(2, Rgb{.3f, .3f, .3f});
  for (const Rgb& w : weights_beside({}, even))
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(w[c], 1, 1e-5) << "no plane is known";
  for (const Rgb& w : weights_beside({}, std::vector<Rgb>(2))) EXPECT_EQ(w, (Rgb{1, 1, 1}));
}

}  // namespace
}  // namespace penumbra::runtime
