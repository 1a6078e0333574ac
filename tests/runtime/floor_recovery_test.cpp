#include "runtime/shading/floor_recovery.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "runtime/pipeline/light_estimation_stage.h"

#include <gtest/gtest.h>

#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {
namespace {

// A clear sky whose sun is saturated in every exposure of the environment camera.
struct ClippedSun {
  std::shared_ptr<capture::FloorWorld> world =
      *capture::FloorWorld::make(capture::make_sky_environment(1024, 512, .8));
  PreparedScene scene;
  capture::StudioOptions options;
  StageTimes times;
  Rgb truth;  // irradiance of a surface that faces the sun

  ClippedSun() {
    scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, world->mean_floor_albedo(), {}});
    PreparedObject object;
    object.name = "place";
    scene.objects.push_back(std::move(object));
    options.view_width = 320, options.view_height = 180;
    options.view_focal_px = 236;
    options.world_from_view = capture::look_at({.25, .8, 1.75}, {.02, .3, 0});
    options.view_frames = 30;
    options.sensor.response = calib::Response::srgb();
    options.schedule = {{Seconds(4e-3), Gain(1)}, {Seconds(1e-3), Gain(1)}};
    lighting::LightExtraction split;
    EXPECT_TRUE(lighting::extract_lights(world->environment(), {}, split));
    truth = split.lights.at(0).irradiance();
  }
};

struct Watched {
  lighting::LightEstimate first, last;
  std::optional<Error> error;
};

// Runs light and completion together as the runner does; `change` may spoil view frames.
Watched watch(ClippedSun& c, FloorRecovery& recovery,
              const std::function<void(Image<Rgb8>&)>& change = {}) {
  capture::Studio studio(c.world, c.options);
  auto light = *LightEstimationStage::create(studio.cameras(), {}, c.times);
  const ResponseTable curve = capture::make_response_table(c.options.sensor.response, 8, 0);
  Watched out;
  while (auto frame = *studio.next()) {
    if (light.takes(frame->camera)) {
      out.last = *light.process(*frame);
      if (!out.first.valid) out.first = out.last;
      continue;
    }
    if (change) {
      auto pixels = std::get<Image<Rgb8>>(*frame->pixels);
      change(pixels);
      frame->pixels = std::make_shared<const FramePixels>(std::move(pixels));
    }
    const auto& camera = studio.cameras()[static_cast<std::size_t>(frame->camera)];
    auto found = recovery.observe(*frame, camera, &curve, out.last);
    if (found)
      light.complete(*found);
    else
      out.error = found.error();
  }
  return out;
}

float sun_fraction(const lighting::LightEstimate& light, const Rgb& truth) {
  return light.lights.empty() ? 0 : luminance(light.lights[0].irradiance()) / luminance(truth);
}

TEST(FloorRecovery, ClippedSunGetsItsEnergyBack) {
  ClippedSun c;
  auto recovery = *FloorRecovery::create(c.scene);
  const Watched w = watch(c, recovery);
  EXPECT_FALSE(w.error) << w.error->detail;
  const auto before = double(sun_fraction(w.first, c.truth)),
             after = double(sun_fraction(w.last, c.truth));
  std::printf("saturated sun: %.3f of its irradiance, as measured %.3f\n", after, before);
  EXPECT_LT(before, .5) << "the naive form: as measured";
  EXPECT_NEAR(after, 1, .05);
  for (int ch = 0; ch < 3; ++ch)
    EXPECT_NEAR(w.last.lights[0].irradiance()[ch] / c.truth[ch], 1, .08f) << ch;
  EXPECT_NEAR(w.last.lights[0].radius.value(), lighting::kSunRadius.value(), 1e-6);
}

TEST(FloorRecovery, RealShadowOverAThirdOfTheFloorDoesNotCount) {
  ClippedSun c;
  auto recovery = *FloorRecovery::create(c.scene);
  const Watched w = watch(c, recovery, [](Image<Rgb8>& picture) {
    for (int y = 0; y < picture.height(); ++y)
      for (int x = 0; x < picture.width() / 3; ++x)
        picture.at(x, y) = {static_cast<std::uint8_t>(picture.at(x, y).r / 3),
                            static_cast<std::uint8_t>(picture.at(x, y).g / 3),
                            static_cast<std::uint8_t>(picture.at(x, y).b / 3)};
  });
  EXPECT_NEAR(sun_fraction(w.last, c.truth), 1, .06f);
}

// More than half of the floor around the object lies in the shadow of a thing that is known.
TEST(FloorRecovery, ShadowOfAKnownThingOverMostOfTheFloorDoesNotCount) {
  ClippedSun c;
  c.options.view_width = 640, c.options.view_height = 360, c.options.view_focal_px = 472;
  lighting::LightExtraction split;
  ASSERT_TRUE(lighting::extract_lights(c.world->environment(), {}, split));
  const glm::vec3 sun(split.lights.at(0).direction), middle = 4.f * sun;
  const PreparedScene without = c.scene;
  c.scene.real_mesh =
      prt::make_box(middle - glm::vec3(.75f), middle + glm::vec3(.75f), 1, {.5f, .5f, .5f});
  const auto box = *prt::RayScene::build(c.scene.real_mesh);
  int dark = 0, near = 0;
  const auto shade = [&](Image<Rgb8>& picture) {
    dark = near = 0;
    for (int y = 0; y < picture.height(); ++y)
      for (int x = 0; x < picture.width(); ++x) {
        const Pose& eye = c.options.world_from_view;
        const glm::dvec3 d =
            eye.rotation * glm::dvec3((x + .5 - 320) / 472, (180 - y - .5) / 472, -1);
        if (d.y >= 0) continue;
        const glm::dvec3 at = eye.translation - eye.translation.y / d.y * d;
        const bool in_shade = box.occluded(glm::vec3(at), sun, 1e-3f, 100);
        if (glm::length(at) < FloorRecovery::kNear_m) ++near, dark += in_shade;
        if (!in_shade) continue;
        Rgb8& p = picture.at(x, y);
        p = {static_cast<std::uint8_t>(p.r / 3), static_cast<std::uint8_t>(p.g / 3),
             static_cast<std::uint8_t>(p.b / 3)};
      }
  };
  auto naive = *FloorRecovery::create(without);
  EXPECT_LT(sun_fraction(watch(c, naive, shade).last, c.truth), .6f) << "the test shows nothing";
  EXPECT_GT(dark, near / 2) << near;
  auto recovery = *FloorRecovery::create(c.scene);
  EXPECT_NEAR(sun_fraction(watch(c, recovery, shade).last, c.truth), 1, .06f);
}

TEST(FloorRecovery, OverexposedFloorSaysSoAndLeavesTheLight) {
  ClippedSun c;
  auto recovery = *FloorRecovery::create(c.scene);
  const Watched w = watch(c, recovery, [](Image<Rgb8>& picture) {
    std::ranges::fill(picture.pixels(), Rgb8{255, 255, 255});
  });
  ASSERT_TRUE(w.error);
  EXPECT_EQ(w.error->code, ErrorCode::kUndetermined);
  EXPECT_NEAR(sun_fraction(w.last, c.truth), sun_fraction(w.first, c.truth), .02f);
}

// Two fifths and more of the floor are blown out, which is no reason to give the sun up.
TEST(FloorRecovery, PartlyOverexposedFloorStillTells) {
  ClippedSun c;
  const capture::Studio studio(c.world, c.options);
  const Image<Rgb>& floor = studio.view_radiance();
  std::vector<float> brightest;
  for (int y = floor.height() / 2; y < floor.height(); ++y)
    for (const Rgb& p : floor.row(y)) brightest.push_back(std::max({p.r, p.g, p.b}));
  const auto full = brightest.begin() + static_cast<std::ptrdiff_t>(brightest.size() * 55 / 100);
  std::ranges::nth_element(brightest, full);
  c.options.view_exposure = Exposure{Seconds(1 / double(*full)), Gain(1)};
  auto recovery = *FloorRecovery::create(c.scene);
  double saturated = 0, count = 0;
  const Watched w = watch(c, recovery, [&](Image<Rgb8>& picture) {
    for (int y = picture.height() / 2; y < picture.height(); ++y)
      for (const Rgb8& p : picture.row(y)) saturated += std::max({p.r, p.g, p.b}) == 255, ++count;
  });
  ASSERT_GT(saturated, .3 * count);
  EXPECT_FALSE(w.error) << w.error->detail;
  EXPECT_NEAR(sun_fraction(w.last, c.truth), 1, .06f);
}

TEST(FloorRecovery, BlackFloorIsNoMeasurement) {
  ClippedSun c;
  auto recovery = *FloorRecovery::create(c.scene);
  const Watched w =
      watch(c, recovery, [](Image<Rgb8>& picture) { std::ranges::fill(picture.pixels(), Rgb8{}); });
  ASSERT_TRUE(w.error);
  EXPECT_EQ(w.error->code, ErrorCode::kUndetermined);
  EXPECT_NEAR(sun_fraction(w.last, c.truth), sun_fraction(w.first, c.truth), .02f);
}

TEST(FloorRecovery, IdleWithoutAKnownAlbedo) {
  ClippedSun c;
  c.scene.planes[0].albedo = {};
  auto recovery = *FloorRecovery::create(c.scene);
  const Watched w = watch(c, recovery);
  EXPECT_FALSE(w.error);
  EXPECT_NEAR(sun_fraction(w.last, c.truth), sun_fraction(w.first, c.truth), .02f);
}

}  // namespace
}  // namespace penumbra::runtime
