// Worlds that real rooms are made of, path traced with the virtual objects really in them, against
// the composite.
#include <gtest/gtest.h>

#include <cmath>

#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/mesh_files.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"

namespace penumbra::tools {

using namespace runtime;
namespace {

using glm::dvec3;
using test::twist, test::grey_plane;

constexpr int kRows = 256;

// A light of light on top of what is there.
void add_lamp(Image<Rgb>& map, const dvec3& towards, double radius_rad, Rgb radiance) {
  const dvec3 centre = glm::normalize(towards);
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      double covered = 0;  // sixteen samples a pixel
      for (int k = 0; k < 16; ++k)
        covered += glm::dot(latlong_direction(x + (k % 4 + .5) / 4, y + (k / 4 + .5) / 4,
                                              map.width(), map.height()),
                            centre) > std::cos(radius_rad)
                       ? 1. / 16
                       : 0;
      map.at(x, y) += radiance * static_cast<float>(covered);
    }
}

Image<Rgb> dim_room() {
  Image<Rgb> map = capture::make_room_environment(2 * kRows, kRows);
  for (Rgb& c : map.pixels()) c = Rgb{.3f, .3f, .3f} + Rgb{c.r, c.g, c.b} * .02f;
  return map;
}

// A dark room with a window of four panes, the sun behind the frame's cross so that half of it
// shows.
Image<Rgb> window_room() {
  Image<Rgb> map(2 * kRows, kRows, {.25f, .24f, .22f});
  Image<Rgb> outside = capture::make_sky_environment(2 * kRows, kRows, .6);
  dvec3 sun(0);
  float brightest = 0;
  for (int y = 0; y < kRows; ++y)
    for (int x = 0; x < 2 * kRows; ++x)
      if (luminance(outside.at(x, y)) > brightest)
        brightest = luminance(outside.at(x, y)),
        sun = latlong_direction(x + .5, y + .5, 2 * kRows, kRows);
  const dvec3 side = glm::normalize(glm::cross(sun, dvec3(0, 1, 0))), up = glm::cross(side, sun);
  for (int y = 0; y < kRows; ++y)
    for (int x = 0; x < 2 * kRows; ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, 2 * kRows, kRows);
      const double depth = glm::dot(d, sun), u = glm::dot(d, side) / depth,
                   v = glm::dot(d, up) / depth;
      const bool in_frame = depth > 0 && std::abs(u) < .4 && std::abs(v) < .5;
      const bool on_cross = std::abs(u + .02) < .02 || std::abs(v - .2) < .02;
      if (in_frame && !on_cross) map.at(x, y) = outside.at(x, y);
    }
  return map;
}

// A wide window whose sill lies below the eyes, so that part of its light comes from below the
// horizon and none of that reaches the floor.
Image<Rgb> window_to_the_sill() {
  Image<Rgb> map(2 * kRows, kRows);
  for (int y = 0; y < kRows; ++y)
    for (int x = 0; x < 2 * kRows; ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, 2 * kRows, kRows);
      const double up = d.y / d.z, aside = d.x / d.z;
      map.at(x, y) = d.y < 0 ? Rgb{.05f, .045f, .04f} : Rgb{.09f, .08f, .075f};
      if (d.z > 0 && up > -.1 && up < .9 && aside > -.7 && aside < .5) map.at(x, y) = {9, 11, 14};
    }
  return map;
}

Image<Rgb> coloured_sun() {
  Image<Rgb> map(2 * kRows, kRows);
  for (int y = 0; y < kRows; ++y)
    for (int x = 0; x < 2 * kRows; ++x)
      map.at(x, y) = y < kRows / 2 ? Rgb{.15f, .3f, .8f} : Rgb{.1f, .1f, .1f};
  add_lamp(map, {.8, .5, .4}, .01, {20000, 9000, 2500});
  return map;
}

Image<Rgb> two_suns() {
  Image<Rgb> map = coloured_sun();
  add_lamp(map, {.3, .8, .9}, .01, {1500, 4000, 14000});
  return map;
}

struct World {
  const char* name;
  std::function<Scene(const std::filesystem::path& folder)> scene;
  std::function<std::vector<Image<Rgb>>()>
      maps;  // one after the other, a thirtieth of a second apart
  double shadow_bar, object_bar;
};
void PrintTo(const World& w, std::ostream* out) {
  *out << w.name;
}

Scene on_floor(const std::filesystem::path&) {
  return {{twist({0, 0, 0})}, {grey_plane()}};
}

Scene beside_real_mesh(const std::filesystem::path& folder) {
  test::write_obj(prt::make_box({.2f, 0, -.2f}, {.5f, .5f, .2f}, 8, {.4f, .4f, .4f}),
                  folder / "prop.obj");
  RealGeometry prop;
  prop.mesh = (folder / "prop.obj").string();
  prop.albedo = Rgb{.4f, .4f, .4f};
  return {{twist({-.12, 0, 0})}, {grey_plane(), prop}};
}

// A ball in the shadow of another, of triangles that are larger than the edges of shadows on them.
Scene ball_below_a_ball(const std::filesystem::path& folder) {
  prt::Mesh both = prt::make_sphere({0, .22f, 0}, .22f, 3, {.6f, .6f, .6f});
  prt::append(both, prt::make_sphere({.3f, .5f, .12f}, .12f, 3, {.6f, .6f, .6f}));
  test::write_obj(both, folder / "balls.obj");
  SceneObject balls;
  balls.asset = (folder / "balls.obj").string();
  balls.name = "balls";
  balls.place_on_floor = true;
  return {{balls}, {grey_plane()}};
}

SceneObject block(const std::filesystem::path& folder, const char* name, const dvec3& position,
                  const glm::vec3& size) {
  const auto file = folder / (std::string(name) + ".obj");
  test::write_obj(prt::make_box({0, 0, 0}, size, 8, {.7f, .7f, .7f}), file);
  SceneObject out;
  out.asset = file.string();
  out.name = name;
  out.position = position;
  return out;
}

// The side of a block that the sun lights lies in the shadow of another for most of its height.
Scene block_in_shade(const std::filesystem::path& folder) {
  return {{block(folder, "lit", {-.2, 0, -.2}, {.3f, .3f, .5f}),
           block(folder, "before", {.3, 0, 0}, {.08f, .35f, .5f})},
          {grey_plane()}};
}

class ReferenceWorld : public testing::TestWithParam<World> {};

TEST_P(ReferenceWorld, CompositeFollowsTheWorldWithTheObjectInIt) {
  const World& world = GetParam();
  const test::TempFolder folder;
  const auto scene = test::prepared(world.scene(folder.path()));
  ASSERT_TRUE(scene) << scene.error().detail;
  const prt::PinholeView view{
      112, 84, {105, 105}, {56, 42}, capture::look_at({.5, 1.2, 1.5}, {0, .15, 0})};
  const auto masks = make_masks(*scene, view);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks) << masks.error().detail;
  auto pipeline = make_still_pipeline(*scene, view, {});
  ASSERT_TRUE(pipeline);
  lighting::LightEstimator estimator({5, {}});
  int map_index = 0;
  for (const Image<Rgb>& map : world.maps()) {
    Environment environment;
    environment.radiance = map;
    environment.time = TimestampNs{0} + Seconds(map_index++ / 30.);
    const auto light = estimator.estimate(environment);
    ASSERT_TRUE(light);
    const StillScene in{&*scene, &map, view};
    const auto empty = render_real(in, .008, {});
    const auto truth = render_reference(in, true, .008, std::nullopt, {});
    ASSERT_TRUE(empty && truth);
    const auto ours = composite_still(*pipeline, view, *light, *empty);
    ASSERT_TRUE(ours);
    const Accuracy a = compare_pictures(*ours, *truth, *empty, *masks),
                   naive = compare_pictures(*empty, *truth, *empty, *masks);
    std::printf("%s %d: %zu lights, shadow %.4f (none %.2f), object %.2f %%, bias %.2f %%\n",
                world.name, map_index, light->lights.size(), a.shadow_rmse, naive.shadow_rmse,
                100 * a.object_without_noise, 100 * a.object_bias);
    EXPECT_LT(a.shadow_rmse, world.shadow_bar);
    EXPECT_LT(a.object_without_noise, world.object_bar);
    EXPECT_GT(naive.shadow_rmse, 2 * a.shadow_rmse) << "without a shadow";
  }
}

const World kWorlds[] = {
    {"coloured_sun", on_floor, [] { return std::vector{coloured_sun()}; }, .05, .05},
    // 1.2 % with shadows' edges as wide as triangles.
    {"coarse_balls", ball_below_a_ball, [] { return std::vector{coloured_sun()}; }, .05, .01},
    // .10 if what the blocks reflect onto the floor is dimmed alike all over it.
    {"block_in_shade", block_in_shade, [] { return std::vector{coloured_sun()}; }, .02, .05},
    // The blue one of them reaches all of both.
    {"block_in_shade_of_one", block_in_shade, [] { return std::vector{two_suns()}; }, .02, .05},
    {"window_frame", on_floor, [] { return std::vector{window_room()}; }, .05, .05},
    // Before windows were more than round: shadow .023, object .7 %.
    {"window_to_the_sill", on_floor, [] { return std::vector{window_to_the_sill()}; }, .018, .015},
    {"moving_lamp", on_floor,
     [] {
       std::vector<Image<Rgb>> maps;
       for (const double angle : {0., .12, .24}) {
         maps.push_back(dim_room());
         add_lamp(maps.back(), {std::cos(angle), .9, std::sin(angle)}, .08, {120, 110, 90});
       }
       return maps;
     },
     .05, .05},
    {"tilted_floor",
     [](const std::filesystem::path&) {
       return Scene{{twist({0, 0, 0})}, {grey_plane({0, 0, 0}, {.35, 1, .1})}};
     },
     [] { return std::vector{capture::make_sky_environment(2 * kRows, kRows, .8)}; }, .05, .05},
    {"two_objects_sky",
     [](const std::filesystem::path&) {
       return Scene{{twist({-.2, 0, 0}), twist({.2, 0, .05})}, {grey_plane()}};
     },
     [] { return std::vector{capture::make_sky_environment(2 * kRows, kRows, .8)}; }, .05, .05},
    {"two_objects_room",
     [](const std::filesystem::path&) {
       return Scene{{twist({-.2, 0, 0}), twist({.2, 0, .05})}, {grey_plane()}};
     },
     [] { return std::vector{capture::make_room_environment(2 * kRows, kRows)}; }, .05, .05},
    {"real_prop_room", beside_real_mesh,
     [] { return std::vector{capture::make_room_environment(2 * kRows, kRows)}; }, .05, .05},
    {"real_prop_sky", beside_real_mesh,
     [] {
       return std::vector{capture::make_sky_environment(2 * kRows, kRows, .8)};
     },  // 19 % if the prop only hides its lights, 9 % with six sides that see the whole floor.
     .05, .08},
};

INSTANTIATE_TEST_SUITE_P(Worlds, ReferenceWorld, testing::ValuesIn(kWorlds),
                         [](const auto& test) { return std::string(test.param.name); });

}  // namespace
}  // namespace penumbra::tools
