// The joined chain of materials: a file of glTF is read, baked, lit by what the studio films and
// composited, and mirrors the room that it stands in.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>
#include <vector>

#include "capture/capture.h"
#include "compositor/composite/compositor.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/scene/scene.h"
#include "tests/support/gl.h"
#include "tests/support/gltf_assets.h"
#include "tests/support/temp_folder.h"

namespace penumbra {
namespace {

using glm::dvec3;

constexpr double kBallRadius = .2;

capture::StudioOptions room_cameras() {
  capture::StudioOptions out;
  out.environment_width = 512;
  out.environment_height = 256;
  out.view_width = 240;
  out.view_height = 160;
  out.view_focal_px = 260;
  out.view_frames = 4;
  out.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
  out.sensor.response = calib::Response::srgb();
  return out;
}

// The last frame of a replay with the asset as a ball on the floor.
Image<Rgb8> filmed_with(const std::string& asset,
                        const std::shared_ptr<capture::FloorWorld>& world) {
  runtime::Scene scene;
  runtime::SceneObject& ball = scene.objects.emplace_back();
  ball.name = "ball";
  ball.asset = asset;
  ball.place_on_floor = true;
  ball.fit_size_m = 2 * kBallRadius;
  runtime::RealGeometry& floor = scene.real.emplace_back();
  floor.plane.emplace();
  floor.albedo = Rgb{.3f, .3f, .3f};
  runtime::BakeSettings settings = runtime::BakeSettings::coarse();
  settings.cache = runtime::BakeCache::kNotUsed;
  auto prepared =
      runtime::prepare(scene, settings, [](const std::string&) { return [](double) {}; });
  EXPECT_TRUE(prepared);
  if (!prepared) return {};
  capture::Studio studio(world, room_cameras());
  auto pipeline = Pipeline::create(studio.cameras(),
                                   std::make_shared<runtime::PreparedScene>(std::move(*prepared)));
  EXPECT_TRUE(pipeline);
  if (!pipeline) return {};
  Image<Rgb8> last;
  const auto run = pipeline->replay(studio, [&](const runtime::Output& out) {
    last = std::get<Image<Rgb8>>(*out.pixels);
    return true;
  });
  EXPECT_TRUE(run);
  return last;
}

// How the picture of the ball goes with the room that a mirror in its place shows, -1..1. What the
// picture shows white tells nothing.
double likeness(const Image<Rgb8>& picture, const capture::FloorWorld& world) {
  const capture::StudioOptions o = room_cameras();
  const dvec3 eye = o.world_from_view.translation, centre(0, kBallRadius, 0);
  std::vector<std::pair<double, double>> both;
  for (int y = 0; y < picture.height(); ++y)
    for (int x = 0; x < picture.width(); ++x) {
      const dvec3 d =
          glm::normalize(o.world_from_view.rotation *
                         dvec3((x + .5 - picture.width() / 2.) / o.view_focal_px,
                               -(y + .5 - picture.height() / 2.) / o.view_focal_px, -1));
      const double b = glm::dot(eye - centre, d),
                   root = b * b - glm::dot(eye - centre, eye - centre) + kBallRadius * kBallRadius;
      if (root < .2 * kBallRadius * kBallRadius || picture.at(x, y).g > 250) continue;
      const dvec3 at = eye + d * (-b - std::sqrt(root)), n = glm::normalize(at - centre);
      const Rgb mirrored = world.radiance(at, d - 2 * glm::dot(d, n) * n);
      both.emplace_back(std::log(1e-3 + mirrored.g), std::log(1. + picture.at(x, y).g));
    }
  EXPECT_GT(both.size(), 800U);
  double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
  const auto count = static_cast<double>(both.size());
  for (const auto& [a, b] : both) ma += a / count, mb += b / count;
  for (const auto& [a, b] : both)
    aa += (a - ma) * (a - ma), bb += (b - mb) * (b - mb), ab += (a - ma) * (b - mb);
  return ab / std::sqrt(aa * bb);
}

TEST(MirroredRoom, AChromeBallFromAFileShowsTheRoomThatTheCamerasFilm) {
  PENUMBRA_NEED_GL(
      compositor::Compositor::create(8, 8, compositor::Compositor::Surface::kOffscreen));
  const test::TempFolder folder;
  const auto file = folder.path() / "chrome.glb";
  test::chrome_ball().write_glb(file);
  const auto world = *capture::FloorWorld::make(capture::make_room_environment(1024, 512));
  const double chrome = likeness(filmed_with(file.string(), world), *world),
               chalk = likeness(filmed_with("builtin:ball", world), *world);
  RecordProperty("chrome", std::to_string(chrome));
  RecordProperty("chalk", std::to_string(chalk));
  EXPECT_GT(chrome, .75);  // the floor is mirrored from where its camera stands
  EXPECT_LT(chalk, .6);    // the naive way
}

}  // namespace
}  // namespace penumbra
