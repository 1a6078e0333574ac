// The light stage on frames that are not what the studio makes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "core/io/log.h"
#include "lighting/lighting.h"
#include "runtime/direct/scene_light.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/shading/composite_stage.h"
#include "tests/support/mains.h"

namespace penumbra::runtime {
namespace {

capture::CameraInfo camera_of(calib::ProjectionKind kind, int width, int height) {
  capture::CameraInfo camera;
  camera.name = "environment";
  camera.projection = *calib::make_projection(kind, width, height);
  return camera;
}

capture::Frame frame_of(Image<Rgb> pixels, std::uint64_t sequence = 0, double exposure_s = 1) {
  capture::Frame frame;
  frame.sequence = sequence;
  frame.time = TimestampNs{static_cast<std::int64_t>(sequence) * 33'000'000};
  frame.exposure = {Seconds(exposure_s), Gain(1)};
  frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
  return frame;
}

struct Stage {
  StageTimes times;
  Result<LightEstimationStage> light;
  explicit Stage(const capture::CameraInfo& camera)
      : light(LightEstimationStage::create({camera}, {.bands = 3}, times)) {}
};

TEST(LightEstimationStage, FloatFramesKeepTheirBrightPixels) {
  Stage s(camera_of(calib::ProjectionKind::kLatLong, 64, 32));
  Image<Rgb> map(64, 32, {1, 1, 1});
  map.at(40, 12) = {20000, 20000, 20000};
  const double expected = 1 + 19999 * latlong_solid_angle(12, 64, 32) / (4 * kPi);
  const auto estimate = s.light->process(frame_of(std::move(map)));
  ASSERT_TRUE(estimate) << estimate.error().detail;
  EXPECT_NEAR(estimate->mean_radiance.g, expected, .002 * expected);
}

// With fewer places than exposures the light of a still scene pulses with the bracket.
TEST(LightEstimationStage, ElevenExposuresOfAStillSceneGiveOneLight) {
  capture::StudioOptions o;
  o.environment_width = 128, o.environment_height = 64;
  o.view_width = 64, o.view_height = 36, o.view_focal_px = 60;
  o.view_frames = 60;
  for (int k = 0; k < 11; ++k) o.schedule.push_back({Seconds(2e-2 * std::pow(.5, k)), Gain(1)});
  capture::Studio studio(*capture::FloorWorld::make(capture::make_room_environment(128, 64)), o);
  StageTimes times;
  auto light = *LightEstimationStage::create(studio.cameras(), {}, times);
  double least = HUGE_VAL, most = 0;
  int frames = 0;
  while (auto frame = *studio.next()) {
    if (!light.takes(frame->camera)) continue;
    const auto estimate = light.process(*frame);
    ASSERT_TRUE(estimate) << estimate.error().detail;
    if (++frames <= 22) continue;
    const auto now = double(luminance(estimate->mean_radiance));
    least = std::min(least, now), most = std::max(most, now);
  }
  ASSERT_GT(frames, 44);
  EXPECT_LT(most / least, 1.005);
}

capture::CameraInfo filmed_by(const capture::Sensor& sensor, int width, int height) {
  capture::CameraInfo camera = camera_of(calib::ProjectionKind::kLatLong, width, height);
  camera.response = sensor.response;
  camera.noise = sensor.noise;
  camera.noise_known = true;
  return camera;
}

// Lamps that swell with the mains under a rolling shutter: the light stands, in all and by itself.
TEST(LightEstimationStage, BandsOfTheMainsDoNotReachTheLight) {
  capture::Sensor sensor;
  sensor.response = calib::Response::srgb();
  const Image<Rgb> room = test::room_on_mains(256, 128);
  Stage s(filmed_by(sensor, 256, 128));
  std::vector<double> all, lamps, up;
  for (std::uint64_t n = 0; n < 300; ++n) {
    const auto estimate =
        s.light->process(test::film_on_mains(sensor, room, n, {.016, .004, .001}, {}));
    ASSERT_TRUE(estimate) << estimate.error().detail;
    if (n < 210) continue;
    all.push_back(double(luminance(estimate->mean_radiance)));
    double sum = 0;
    for (const lighting::DistantLight& l : estimate->lights)
      sum += double(luminance(l.irradiance()));
    lamps.push_back(sum);
    up.push_back(double(luminance(open_irradiance(*estimate, {0, 1, 0}))));
  }
  std::printf("flicker of 20 %% in the light: %.2f %% of it, lamps %.2f %%, a floor %.2f %%\n",
              100 * test::flicker_of(all), 100 * test::flicker_of(lamps),
              100 * test::flicker_of(up));
  EXPECT_GT(lamps[0], 0);
  EXPECT_LT(test::flicker_of(all), .005);
  EXPECT_LT(test::flicker_of(lamps), .005);
  EXPECT_LT(test::flicker_of(up), .005);
}

std::vector<std::string> warnings_of_a_moving_lamp(float brightest) {
  std::vector<std::string> out;
  set_log_sink([&](LogLevel level, std::string_view line) {
    if (level == LogLevel::kWarning) out.emplace_back(line);
  });
  capture::Sensor sensor;
  sensor.response = calib::Response::srgb();
  Stage s(filmed_by(sensor, 256, 128));
  const std::vector<double> times_s = {1, 1. / 4, 1. / 16, 1. / 64};
  for (std::uint64_t n = 0; n < 32; ++n) {
    Image<Rgb> map(256, 128, {.2f, .2f, .2f});
    const int left = static_cast<int>(20 + 40 * n) % 240;
    for (int y = 30; y < 40; ++y)
      for (int x = left; x < left + 10; ++x) map.at(x, y) = {brightest, brightest, brightest};
    EXPECT_TRUE(s.light->process(test::film_on_mains(sensor, map, n, times_s, {100, 0})));
  }
  set_log_sink({});
  return out;
}

// What moves waits for a shorter exposure to see it where it is. That is no saturated camera.
TEST(LightEstimationStage, ALampIsSaturatedOnlyWhereTheShortestExposureClips) {
  EXPECT_TRUE(warnings_of_a_moving_lamp(20).empty());
  const auto bright = warnings_of_a_moving_lamp(200);
  ASSERT_EQ(bright.size(), 1u);
  EXPECT_NE(bright[0].find("saturated in every exposure"), std::string::npos) << bright[0];
}

// Eight exposures, the longest first: what the first ones clip is no light that may be promised,
// nor one that the floor is asked about.
TEST(LightEstimationStage, NothingIsPromisedBeforeTheBracketIsWhole) {
  capture::Sensor sensor;
  sensor.response = calib::Response::srgb();
  Stage s(filmed_by(sensor, 256, 128));
  lighting::GovernorConfig config;
  config.limits.max_error = .9;  // any prediction keeps to it
  config.probes.deficit.assign(kMaxCoefficients, 0);
  s.light->set_governor(config);
  std::vector<double> times_s;
  for (int k = 0; k < 8; ++k) times_s.push_back(std::ldexp(1., -k));
  Image<Rgb> map(256, 128, {.2f, .2f, .2f});
  for (int y = 30; y < 34; ++y)
    for (int x = 100; x < 104; ++x) map.at(x, y) = {60, 60, 60};
  for (std::uint64_t n = 0; n < 12; ++n) {
    const auto light = s.light->process(test::film_on_mains(sensor, map, n, times_s, {100, 0}));
    ASSERT_TRUE(light && light->plan) << n;
    EXPECT_EQ(light->plan->lower_bound, n < 6) << n;
    EXPECT_EQ(light->plan->within_budget, !light->plan->lower_bound) << n;
    EXPECT_TRUE(std::ranges::none_of(light->lights, &lighting::DistantLight::clipped)) << n;
  }
}

// Captures of one bracket, whose exposures never come again.
TEST(LightEstimationStage, ABracketIsWholeOnceNothingMoreComes) {
  capture::Sensor sensor;
  sensor.response = calib::Response::srgb();
  Stage s(filmed_by(sensor, 256, 128));
  Image<Rgb> map(256, 128, {.2f, .2f, .2f});
  for (int y = 30; y < 34; ++y)
    for (int x = 100; x < 104; ++x) map.at(x, y) = {600, 600, 600};
  lighting::LightEstimate light;
  TimestampNs last;
  for (std::uint64_t n = 0; n < 6; ++n) {
    const auto frame = test::film_on_mains(sensor, map, n,
                                           {1, 1. / 2, 1. / 4, 1. / 8, 1. / 16, 1. / 32}, {100, 0});
    last = frame.time;
    ASSERT_TRUE(s.light->process(frame, light));
  }
  const auto clips = [&] {
    return std::ranges::any_of(light.lights, &lighting::DistantLight::clipped);
  };
  ASSERT_TRUE(s.light->settle(last + Seconds(.05), light));
  EXPECT_FALSE(clips()) << "the next one may come";
  EXPECT_FALSE(s.light->ready());
  ASSERT_TRUE(s.light->settle(last + Seconds(.2), light));
  EXPECT_TRUE(clips());
  EXPECT_TRUE(s.light->ready());
}

TEST(LightEstimationStage, NonFinitePixelsAreLeftOutAndDoNotEndTheRun) {
  Stage s(camera_of(calib::ProjectionKind::kLatLong, 64, 32));
  Image<Rgb> map(64, 32, {1, 1, 1});
  map.at(3, 16) = {NAN, 1, INFINITY};
  const auto estimate = s.light->process(frame_of(std::move(map)));
  ASSERT_TRUE(estimate) << estimate.error().detail;
  EXPECT_GT(estimate->clipped_fraction, 0) << "the pixel is not measured, and that is said";
  for (const Rgb& c : estimate->light.terms()) EXPECT_TRUE(is_finite(c));
  EXPECT_NEAR(estimate->mean_radiance.g, 1, .01);
}

TEST(LightEstimationStage, TurnedCameraSeesTheSameLight) {
  // A bright half to the right of the picture; the second frame's camera has turned by half a turn.
  Image<Rgb> map(64, 32, {1, 1, 1});
  for (int y = 0; y < 32; ++y)
    for (int x = 32; x < 64; ++x) map.at(x, y) = {5, 5, 5};
  Stage s(camera_of(calib::ProjectionKind::kLatLong, 64, 32));
  const auto straight = s.light->process(frame_of(map, 0));
  ASSERT_TRUE(straight);
  capture::Frame turned = frame_of(map, 1);
  turned.world_from_camera.rotation = glm::angleAxis(kPi, glm::dvec3(0, 1, 0));
  const auto estimate = s.light->process(turned);
  ASSERT_TRUE(estimate);
  EXPECT_GT(straight->light[3].g, 1);
  EXPECT_NEAR(estimate->light[3].g, -straight->light[3].g, .02 * straight->light[3].g);
}

TEST(LightEstimationStage, ExposureThatTheScheduleLeftBehindIsForgotten) {
  Stage s(camera_of(calib::ProjectionKind::kLatLong, 64, 32));
  ASSERT_TRUE(s.light->process(frame_of(Image<Rgb>(64, 32, {1, 1, 1}), 0, 1)));  // the lamp is on
  Result<lighting::LightEstimate> last = fail(ErrorCode::kClosed, "", "");
  for (std::uint64_t i = 1; i < 20; ++i)
    last = s.light->process(frame_of(Image<Rgb>(64, 32, {.01f, .01f, .01f}), i, .1));
  ASSERT_TRUE(last);
  EXPECT_NEAR(last->mean_radiance.g, .1, .002);
}

TEST(LightEstimationStage, FisheyeOfHalfTheSphereKeepsAConstantSkyConstant) {
  Stage s(camera_of(calib::ProjectionKind::kEquidistant, 128, 128));
  for (std::uint64_t i = 0; i < 2; ++i) {  // the second frame uses the cached fit
    const auto estimate = s.light->process(frame_of(Image<Rgb>(128, 128, {2, 2, 2}), i));
    ASSERT_TRUE(estimate) << estimate.error().detail;
    EXPECT_LT(estimate->coverage, .8);
    EXPECT_NEAR(estimate->light[0].g, 2 * std::sqrt(4 * kPi), .01 * std::sqrt(4 * kPi));
  }
}

TEST(LightEstimationStage, CameraOfOnePixelIsRefused) {
  for (const auto& [w, h] : {std::pair{1, 1}, {2, 1}, {1, 2}}) {
    const Stage s(camera_of(calib::ProjectionKind::kLatLong, w, h));
    ASSERT_FALSE(s.light);
    EXPECT_EQ(s.light.error().where, "environment");
  }
}

TEST(LightEstimationStage, CaptureWithoutEnvironmentCameraIsRefused) {
  capture::CameraInfo view = camera_of(calib::ProjectionKind::kPinhole, 8, 8);
  view.role = capture::Role::kView;
  EXPECT_FALSE(Stage(view).light);
}

}  // namespace
}  // namespace penumbra::runtime
