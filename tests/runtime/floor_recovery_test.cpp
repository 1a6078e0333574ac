#include "runtime/shading/floor_recovery.h"
#include "calib/calib.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/pipeline/pipeline.h"
#include "runtime/pipeline/runner.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/matrix_transform.hpp>
#include <optional>

#include "runtime/shading/composite_stage.h"
#include "runtime/studio/internal/real_mesh_world.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

// A clear sky whose sun is saturated in every exposure of the environment camera; or lamps.
struct ClippedSun {
  std::shared_ptr<capture::FloorWorld> world;
  PreparedScene scene;
  capture::StudioOptions options;
  StageTimes times;
  std::vector<lighting::DistantLight> lights;  // true ones
  Rgb truth;                                   // irradiance of a surface that faces the first

  explicit ClippedSun(Image<Rgb> map = capture::make_sky_environment(1024, 512, .8))
      : world(*capture::FloorWorld::make(std::move(map))) {
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
    lights = split.lights;
    truth = lights.at(0).irradiance();
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
      light.add_recoveries(*found);
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

// A box that keeps lights from the floor around the object, and the shadows that it casts there:
// what is left is all other light, as far as the box lets it through.
class BoxInTheLight {
 public:
  BoxInTheLight(ClippedSun& c, const glm::vec3& middle, float side)
      : eye_(c.options.world_from_view) {
    c.options.view_width = 640, c.options.view_height = 360, c.options.view_focal_px = 472;
    const glm::vec3 half(side / 2);
    c.scene.real_mesh = prt::make_box(middle - half, middle + half, 1, {.5f, .5f, .5f});
    box_.emplace(*prt::RayScene::build(c.scene.real_mesh));
    for (const lighting::DistantLight& light : c.lights) {
      const Rgb whole = c.world->floor_irradiance(), own = lighting::irradiance(light, {0, 1, 0});
      lights_.push_back(
          {glm::vec3(light.direction), {own.r / whole.r, own.g / whole.g, own.b / whole.b}});
    }
  }
  void operator()(Image<Rgb8>& picture) {
    const calib::Response srgb = calib::Response::srgb();
    dark = near = 0;
    for (int y = 0; y < picture.height(); ++y)
      for (int x = 0; x < picture.width(); ++x) {
        const glm::dvec3 d =
            eye_.rotation * glm::dvec3((x + .5 - 320) / 472, (180 - y - .5) / 472, -1);
        if (d.y >= 0) continue;
        const glm::dvec3 at = eye_.translation - eye_.translation.y / d.y * d;
        Rgb left{1, 1, 1};
        for (const Light& light : lights_)
          if (box_->occluded(glm::vec3(at), light.direction, 1e-3f, 100))
            left += light.fraction * -1.f;
        const bool in_shade = left.g < 1;
        if (glm::length(at) < FloorRecovery::kNear_m) ++near, dark += in_shade;
        if (!in_shade) continue;
        Rgb8& p = picture.at(x, y);
        const auto shaded = [&](std::uint8_t code, int ch) {
          return static_cast<std::uint8_t>(
              std::lround(255 * srgb.encode(srgb.decode(code / 255., ch) * double(left[ch]), ch)));
        };
        p = {shaded(p.r, 0), shaded(p.g, 1), shaded(p.b, 2)};
      }
  }
  int dark = 0, near = 0;

 private:
  struct Light {
    glm::vec3 direction;
    Rgb fraction;  // of the floor's light
  };
  Pose eye_;
  std::vector<Light> lights_;
  std::optional<prt::RayScene> box_;
};

// Between the sun and the object.
BoxInTheLight box_in_the_sun(ClippedSun& c, float side, float away = 4) {
  return {c, away * glm::vec3(c.lights[0].direction), side};
}

// More than half of the floor around the object lies in the shadow of a thing that is known.
TEST(FloorRecovery, ShadowOfAKnownThingOverMostOfTheFloorDoesNotCount) {
  ClippedSun c;
  const PreparedScene without = c.scene;
  BoxInTheLight box = box_in_the_sun(c, 1.5f);
  const auto shade = [&](Image<Rgb8>& picture) { box(picture); };
  auto naive = *FloorRecovery::create(without);
  EXPECT_LT(sun_fraction(watch(c, naive, shade).last, c.truth), .6f) << "the test shows nothing";
  EXPECT_GT(box.dark, box.near / 2) << box.near;
  auto recovery = *FloorRecovery::create(c.scene);
  EXPECT_NEAR(sun_fraction(watch(c, recovery, shade).last, c.truth), 1, .06f);
}

// A wrong albedo divides the floor's light by what it is off: by a shadow of a known thing the sun
// comes out right whatever the albedo, and so does the albedo.
TEST(FloorRecovery, AShadowTellsTheSunWhereTheAlbedoIsWrongOrMissing) {
  for (const float factor : {3.f, .3f, 0.f}) {
    ClippedSun c;
    BoxInTheLight box = box_in_the_sun(c, .4f, 8);
    const auto shade = [&](Image<Rgb8>& picture) { box(picture); };
    Rgb& albedo = c.scene.planes[0].albedo;
    albedo = albedo * factor;
    PreparedScene without = c.scene;
    without.real_mesh = {};
    auto naive = *FloorRecovery::create(without);
    const float by_albedo = sun_fraction(watch(c, naive, shade).last, c.truth);
    EXPECT_GT(std::abs(by_albedo - 1), .5f) << factor << ": the test shows nothing";
    auto recovery = *FloorRecovery::create(c.scene);
    const float by_shadow = sun_fraction(watch(c, recovery, shade).last, c.truth);
    std::printf("albedo times %.1f: sun %.3f of its irradiance, by the albedo %.3f\n",
                double(factor), double(by_shadow), double(by_albedo));
    EXPECT_NEAR(by_shadow, 1, .12f) << factor;
  }
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

// A strong bulb and a weak one look alike where both are saturated. The shadows of a known thing
// tell them apart; without it the weak one gets too much and the strong one too little.
TEST(FloorRecovery, ShadowsTellSeveralLampsApart) {
  const double radius = 1.5 * kPi / 180;
  const glm::dvec3 towards[] = {glm::normalize(glm::dvec3(-.7, 1, -.2)),
                                glm::normalize(glm::dvec3(.8, 1, .1))};
  const Rgb radiance[] = {{24000, 20000, 15000}, {3000, 3200, 3600}};
  Image<Rgb> map(1024, 512, {8, 9, 10});
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      for (std::size_t k = 0; k < 2; ++k)
        if (glm::dot(latlong_direction(x + .5, y + .5, 1024, 512), towards[k]) > std::cos(radius))
          map.at(x, y) = radiance[k];
  for (const bool thing : {false, true}) {
    ClippedSun c(map);
    ASSERT_EQ(c.lights.size(), 2u);
    BoxInTheLight box(c, {.3f, 1.1f, -.4f}, .3f);
    PreparedScene without = c.scene;
    without.real_mesh = {};
    auto recovery = *FloorRecovery::create(thing ? c.scene : without);
    const Watched w = watch(c, recovery, [&](Image<Rgb8>& picture) {
      if (thing) box(picture);
    });
    ASSERT_EQ(w.last.lights.size(), 2u);
    const auto fraction = [&](std::size_t k) {
      const lighting::DistantLight& truth = c.lights[k];
      const lighting::DistantLight& found = *std::ranges::max_element(
          w.last.lights, {},
          [&](const lighting::DistantLight& d) { return glm::dot(d.direction, truth.direction); });
      return luminance(found.irradiance()) / luminance(truth.irradiance());
    };
    std::printf("%s: strong lamp %.3f, weak lamp %.3f of their irradiance\n",
                thing ? "with shadows" : "by the floor alone", double(fraction(0)),
                double(fraction(1)));
    if (thing) {
      EXPECT_NEAR(fraction(0), 1, .06f);
      EXPECT_NEAR(fraction(1), 1, .15f);
    } else {
      EXPECT_GT(fraction(1), 2) << "the test shows nothing";
    }
  }
}

// A sunlit wall brightens the floor before it. Whoever takes that for the sun's own light makes the
// sun too strong, and all objects with it.
TEST(FloorRecovery, LightThatAWallSendsToTheFloorIsNotTheSuns) {
  ClippedSun c;
  const glm::dvec3 sun = c.lights.at(0).direction;
  // Behind the object as the sun sees it, upright and turned to the sun.
  const double azimuth = std::atan2(sun.x, sun.z);
  prt::Mesh wall = prt::make_box({-.9f, 0, -.1f}, {.9f, 1.4f, 0}, 1, {.7f, .7f, .7f});
  glm::dmat4 turn = glm::rotate(glm::dmat4(1), azimuth, glm::dvec3(0, 1, 0));
  turn[3] = glm::dvec4(-.7 * std::sin(azimuth), 0, -.7 * std::cos(azimuth), 1);
  prt::transform(wall, turn);
  c.scene.real_mesh = wall;
  const auto world = *RealMeshWorld::make(c.world, wall, {});
  std::printf("the floor before the wall has %.3f of the open floor's light\n",
              double(luminance(world->floor_fraction({0, 0, 0}))));
  PreparedScene black = c.scene;  // the naive form: the wall takes light and sends none
  for (Rgb& albedo : black.real_mesh.albedo) albedo = {};
  const auto recovered = [&](const PreparedScene& scene) {
    capture::Studio studio(world, c.options);
    auto light = *LightEstimationStage::create(studio.cameras(), {}, c.times);
    auto recovery = *FloorRecovery::create(scene);
    const ResponseTable curve = capture::make_response_table(c.options.sensor.response, 8, 0);
    lighting::LightEstimate last;
    while (auto frame = *studio.next()) {
      if (light.takes(frame->camera)) {
        last = *light.process(*frame);
        continue;
      }
      const auto found = recovery.observe(*frame, studio.cameras()[1], &curve, last);
      EXPECT_TRUE(found) << found.error().detail;
      if (found) light.add_recoveries(*found);
    }
    return sun_fraction(last, c.truth);
  };
  const float naive = recovered(black), known = recovered(c.scene);
  std::printf("sun %.3f of its irradiance, %.3f if the wall sends nothing\n", double(known),
              double(naive));
  EXPECT_GT(naive, 1.06f) << "the test shows nothing";
  EXPECT_NEAR(known, 1, .03f);
}

// A source that cannot be asked for darker frames.
class Deaf : public capture::FrameSource {
 public:
  explicit Deaf(capture::FrameSource& source) : source_(source) {}
  const std::vector<capture::CameraInfo>& cameras() const override { return source_.cameras(); }
  double view_rate() const override { return source_.view_rate(); }
  Result<std::optional<capture::Frame>> next() override { return source_.next(); }

 private:
  capture::FrameSource& source_;
};

// A view camera whose exposure leaves all of the floor white tells nothing; the run asks it for a
// darker frame, and for a still darker one, which the user never sees.
class OverexposedFloor : public testing::Test {
 protected:
  ClippedSun c_;
  StageTimes times_;
  std::unique_ptr<CompositeStage> compose_;
  lighting::LightEstimate last_;
  int shown_ = 0;

  void SetUp() override {
    c_.options.view_exposure = capture::Studio(c_.world, c_.options).view_exposure();
    prt::BakeOptions bake;
    bake.rays = bake.ground_rays = 64;
    bake.bounces = 1;
    c_.scene.objects[0].baked =
        *prt::bake(prt::make_sphere({0, .2f, 0}, .2f, 2, {.5f, .5f, .5f}), bake);
  }
  // `run` is given a source of frames that are overexposed by the factor.
  template <class Run>
  void film(double over, bool fixed_exposure, Run run) {
    capture::StudioOptions options = c_.options;
    options.view_exposure->time *= over;
    capture::Studio studio(c_.world, options);
    Deaf same(studio);
    auto light = *LightEstimationStage::create(studio.cameras(), {}, times_);
    auto compose = CompositeStage::create(studio.cameras(), c_.scene,
                                          compositor::Compositor::Surface::kOffscreen, times_);
    if (!compose && compose.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1 here: " << compose.error().detail;
    shown_ = 0;
    const Sink sink = [&](const Output& out) {
      EXPECT_FALSE(out.source.for_light);
      EXPECT_EQ(out.source.exposure.time, options.view_exposure->time);
      last_ = out.light;
      return ++shown_ < kMaxShown && (!until_recovered_ || !is_recovered());
    };
    ASSERT_TRUE(run(fixed_exposure ? static_cast<capture::FrameSource&>(same) : studio, light,
                    **compose, sink));
  }
  bool is_recovered() const {
    return last_.valid && !last_.lights.empty() && !last_.lights[0].is_lower_bound();
  }

  static constexpr int kMaxShown = 3000;
  bool until_recovered_ = false;
};

TEST_F(OverexposedFloor, IsFilmedOnceMoreDarker) {
  for (const double over : {10., 60.})
    for (const bool fixed_exposure : {true, false}) {
      film(over, fixed_exposure, [&](auto& source, auto& light, auto& compose, const Sink& sink) {
        return run_replay(source, light, compose, sink, times_);
      });
      EXPECT_EQ(shown_, c_.options.view_frames);
      EXPECT_EQ(is_recovered(), !fixed_exposure) << over;
      if (fixed_exposure)
        EXPECT_LT(sun_fraction(last_, c_.truth), .5f) << over;
      else
        EXPECT_NEAR(sun_fraction(last_, c_.truth), 1, .06f) << over;
    }
}

// Whoever hands frames in one by one is told what would help, and helps or does not.
TEST_F(OverexposedFloor, ACallerIsToldOfTheDarkerFrameThatWouldTell) {
  c_.options.view_exposure->time *= 10;
  capture::Studio studio(c_.world, c_.options);
  auto pipeline =
      Pipeline::create(studio.cameras(), std::make_shared<const PreparedScene>(c_.scene));
  if (!pipeline && pipeline.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << pipeline.error().detail;
  ASSERT_TRUE(pipeline);
  int told = 0, taken = 0;
  while (auto frame = *studio.next()) {
    if (pipeline->shows_surroundings(frame->camera)) {
      ASSERT_TRUE(pipeline->add_environment(*frame));
      continue;
    }
    const auto out = pipeline->composite(*frame);
    ASSERT_TRUE(out);
    if (frame->for_light) {
      ++taken;
      EXPECT_TRUE(out->pixels == *frame->pixels) << "nothing is drawn into it";
    }
    if (!out->darker_view) continue;
    ++told;
    EXPECT_LT(*out->darker_view, 1);
    EXPECT_TRUE(studio.take_darker(frame->camera, *out->darker_view));
  }
  EXPECT_GT(told, 0);
  EXPECT_GT(taken, 0);
  EXPECT_NEAR(sun_fraction(pipeline->light(), c_.truth), 1, .06f);
}

TEST_F(OverexposedFloor, IsFilmedDarkerInALiveRun) {
  c_.options.view_frames = kMaxShown;
  c_.options.environment_width = 256, c_.options.environment_height = 128;
  until_recovered_ = true;
  film(10, false, [&](auto& source, auto& light, auto& compose, const Sink& sink) {
    const std::atomic<bool> stop = false;
    return run_live(source, light, compose, sink, times_, stop);
  });
  EXPECT_TRUE(is_recovered());
  EXPECT_LT(shown_, kMaxShown);
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

// A fisheye that looks forward, and a sun behind it: its place is known, its power is read off the
// floor.
class UnseenSun : public testing::Test {
 protected:
  static constexpr int kSide = 512;
  ClippedSun c_;
  glm::dvec3 sun_;
  capture::CameraInfo fisheye_;

  UnseenSun() {
    lighting::LightExtraction split;
    EXPECT_TRUE(lighting::extract_lights(c_.world->environment(), {}, split));
    sun_ = split.lights.at(0).direction;
    fisheye_.name = "fisheye";
    fisheye_.projection =
        *calib::make_projection(calib::ProjectionKind::kEquidistant, kSide, kSide);
    fisheye_.projection.focal_px = glm::dvec2(kSide / (184 * kPi / 180));
    fisheye_.lenses = {{0, 0, fisheye_.projection, {1, 0, 0, 0}, 92 * kPi / 180}};
    // It looks level, away from the sun.
    fisheye_.world_from_camera.rotation =
        glm::angleAxis(std::atan2(sun_.x, sun_.z), glm::dvec3(0, 1, 0));
  }

  // Where and when the sun stands there.
  lighting::SunSite site() const {
    using namespace std::chrono;
    const auto at = [](sys_seconds utc) { return lighting::sun_direction({50, 0, 0, {}}, utc); };
    sys_seconds low = sys_days{2026y / June / 21}, high = low + 12h;
    while (high - low > 1s) {
      const sys_seconds middle = low + (high - low) / 2;
      (at(middle).y < sun_.y ? low : high) = middle;
    }
    const glm::dvec3 there = at(low);
    const double turn = std::atan2(sun_.x, -sun_.z) - std::atan2(there.x, -there.z);
    return {50, 0, std::remainder(turn * 180 / kPi, 360.), low};
  }

  capture::Frame fisheye_frame() const {
    const Image<Rgb>& map = c_.world->environment();
    Image<Rgb> out(kSide, kSide);
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x) {
        const auto d = calib::direction_from_pixel(fisheye_.projection, {x + .5, y + .5});
        if (!d || std::acos(-d->z) > fisheye_.lenses[0].half_field_of_view_rad) continue;
        const glm::dvec2 px =
            latlong_pixel(fisheye_.world_from_camera.rotation * *d, map.width(), map.height());
        out.at(x, y) = map.at(std::min(static_cast<int>(px.x), map.width() - 1),
                              std::min(static_cast<int>(px.y), map.height() - 1));
      }
    capture::Frame frame;
    frame.exposure = {Seconds(1), Gain(1)};
    frame.world_from_camera = fisheye_.world_from_camera;
    frame.pixels = std::make_shared<const FramePixels>(std::move(out));
    return frame;
  }

  // The light after a view frame or two.
  Watched watch(std::optional<lighting::SunSite> sun) {
    capture::Studio studio(c_.world, c_.options);
    auto light = *LightEstimationStage::create({fisheye_}, {.sun = sun}, c_.times);
    auto recovery = *FloorRecovery::create(c_.scene);
    const ResponseTable curve = capture::make_response_table(c_.options.sensor.response, 8, 0);
    Watched out;
    for (int shown = 0; shown < 3;) {
      capture::Frame frame = **studio.next();
      const auto& camera = studio.cameras()[static_cast<std::size_t>(frame.camera)];
      if (camera.role != capture::Role::kView) continue;
      ++shown;
      capture::Frame around = fisheye_frame();
      around.time = frame.time;
      out.last = *light.process(around);
      if (!out.first.valid) out.first = out.last;
      const auto found = recovery.observe(frame, camera, &curve, out.last);
      if (found)
        light.add_recoveries(*found);
      else
        out.error = found.error();
    }
    return out;
  }
};

TEST_F(UnseenSun, GetsItsPowerFromTheFloor) {
  const Watched naive = watch(std::nullopt), known = watch(site());
  EXPECT_TRUE(naive.last.lights.empty()) << "nothing tells of a sun";
  EXPECT_FALSE(known.error) << known.error->detail;
  ASSERT_EQ(known.first.lights.size(), 1u);
  EXPECT_TRUE(known.first.lights[0].is_lower_bound()) << "until the floor was seen";
  ASSERT_EQ(known.last.lights.size(), 1u);
  const lighting::DistantLight& sun = known.last.lights[0];
  EXPECT_EQ(sun.id, lighting::kUnseenSun);
  EXPECT_FALSE(sun.is_lower_bound());
  EXPECT_GT(glm::dot(sun.direction, sun_), std::cos(.3 * kPi / 180));
  const auto fraction = double(luminance(sun.irradiance()) / luminance(c_.truth));
  std::printf("unseen sun: %.3f of its irradiance, coverage %.2f\n", fraction, known.last.coverage);
  EXPECT_NEAR(fraction, 1, .1);
}

// Turned round within a run the camera sees it, saturated, and then no more: its power goes with
// it.
TEST_F(UnseenSun, KeepsItsPowerWhenItComesIntoViewAndLeavesIt) {
  fisheye_.response = calib::Response::srgb();
  auto light = *LightEstimationStage::create({fisheye_}, {.sun = site()}, c_.times);
  const glm::dquat away = fisheye_.world_from_camera.rotation,
                   towards = glm::angleAxis(kPi, glm::dvec3(0, 1, 0)) * away;
  const auto shown = [&](const glm::dquat& turn, double seconds) {
    fisheye_.world_from_camera.rotation = turn;
    capture::Frame frame = fisheye_frame();
    const auto& radiance = std::get<Image<Rgb>>(*frame.pixels);
    Image<Rgb8> codes(kSide, kSide);  // full scale at a radiance of 1000
    const auto code = [&](float value, int ch) {
      const double signal = std::min(double(value) / 1000, 1.);
      return static_cast<std::uint8_t>(std::lround(255 * fisheye_.response.encode(signal, ch)));
    };
    for (std::size_t i = 0; i < codes.area(); ++i) {
      const Rgb& p = radiance.pixels()[i];
      codes.pixels()[i] = {code(p.r, 0), code(p.g, 1), code(p.b, 2)};
    }
    frame.pixels = std::make_shared<const FramePixels>(std::move(codes));
    frame.exposure = {Seconds(1e-3), Gain(1)};
    frame.time = TimestampNs{static_cast<std::int64_t>(seconds * 1e9)};
    return *light.process(frame);
  };
  const auto power = [](const lighting::DistantLight& d) {
    return double(luminance(d.radiance)) * d.solid_angle_sr();
  };
  lighting::LightEstimate first;
  for (int k = 0; k < 20; ++k) first = shown(away, .1 * k);  // the bracket is known to be whole
  ASSERT_FALSE(first.lights.empty());
  ASSERT_EQ(first.lights.back().id, lighting::kUnseenSun);
  const Rgb sent = c_.truth;
  light.add_recoveries(std::vector{lighting::SaturationRecovery{lighting::kUnseenSun, sent}});
  const double whole = luminance(sent);
  EXPECT_NEAR(power(shown(away, 2).lights[0]), whole, 1e-3 * whole);
  lighting::LightEstimate seen;
  for (int k = 21; k < 60; ++k) seen = shown(towards, .1 * k);  // faded in
  ASSERT_FALSE(seen.lights.empty());
  EXPECT_NE(seen.lights[0].id, lighting::kUnseenSun);
  EXPECT_TRUE(seen.lights[0].clipped);
  EXPECT_TRUE(seen.lights[0].recovered) << "no drop until the floor is read";
  EXPECT_NEAR(power(seen.lights[0]), whole, .1 * whole);
  const auto gone = shown(away, 6.5);
  const auto sun =
      std::ranges::find(gone.lights, lighting::kUnseenSun, &lighting::DistantLight::id);
  ASSERT_NE(sun, gone.lights.end());
  EXPECT_NEAR(power(*sun), whole, .1 * whole);
}

// All of the way: [sun] in a file, frames of both cameras, the shadow in the picture.
TEST_F(UnseenSun, InTheSceneFileCastsItsShadowIntoThePicture) {
  const test::TempFolder folder;
  Scene scene;
  scene.objects.emplace_back();
  scene.objects[0].name = "box";
  scene.objects[0].asset = "builtin:box";
  scene.objects[0].place_on_floor = true;
  scene.objects[0].fit_size_m = .4;
  scene.real.emplace_back();
  scene.real[0].plane = RealPlane{};
  scene.real[0].albedo = c_.world->mean_floor_albedo();
  PipelineOptions options;
  options.bake.rays = options.bake.ground_rays = 64;
  options.bake.max_edge_fraction = .1f;
  const auto shadow_ratio = [&](const std::optional<lighting::SunSite>& sun) -> Result<double> {
    scene.sun = sun;
    PENUMBRA_TRY(write_scene(folder.path() / "scene.toml", scene));
    PENUMBRA_ASSIGN(read, read_scene(folder.path() / "scene.toml"));
    capture::Studio studio(c_.world, c_.options);
    const std::size_t view = studio.cameras()[0].role == capture::Role::kView ? 0 : 1;
    const capture::CameraInfo& camera = studio.cameras()[view];
    PENUMBRA_ASSIGN(pipeline, Pipeline::create({fisheye_, camera}, read, options));
    // Where the shadow of the box's middle, at 35 of its 40 cm, falls.
    const glm::dvec3 at = glm::dvec3(0, .35, 0) - sun_ * (.35 / sun_.y);
    const auto pixel = calib::pixel_from_direction(
        camera.projection, glm::conjugate(camera.world_from_camera.rotation) *
                               (at - camera.world_from_camera.translation));
    if (!pixel) return fail(ErrorCode::kInvalid, "shadow", "is out of the picture");
    double ratio = 1;
    for (int shown = 0; shown < 12;) {  // the light fades in
      capture::Frame frame = **studio.next();
      if (static_cast<std::size_t>(frame.camera) != view) continue;
      ++shown;
      capture::Frame around = fisheye_frame();
      around.time = frame.time;
      frame.camera = 1;
      PENUMBRA_TRY(pipeline.add_environment(around));
      PENUMBRA_ASSIGN(out, pipeline.composite(frame));
      const auto value = [&](const FramePixels& pixels) {
        const Rgb8 c = std::get<Image<Rgb8>>(pixels).at(static_cast<int>(pixel->x),
                                                        static_cast<int>(pixel->y));
        return camera.response.decode(c.g / 255., 1);
      };
      ratio = value(out.pixels) / value(*frame.pixels);
    }
    return ratio;
  };
  const auto naive = shadow_ratio(std::nullopt);
  if (!naive && naive.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << naive.error().detail;
  const auto known = shadow_ratio(site());
  ASSERT_TRUE(naive) << naive.error().detail;
  ASSERT_TRUE(known) << known.error().detail;
  std::printf("shadow of a sun that no camera sees: s = %.2f, %.2f without [sun]\n", *known,
              *naive);
  EXPECT_GT(*naive, .8);
  EXPECT_LT(*naive, 1.01);
  EXPECT_LT(*known, .4);
}

TEST_F(UnseenSun, BehindCloudsSendsNothing) {
  Image<Rgb> grey(1024, 512, {.5f, .5f, .5f});
  c_.world = *capture::FloorWorld::make(std::move(grey));
  c_.scene.planes[0].albedo = c_.world->mean_floor_albedo();
  const Watched known = watch(site());
  ASSERT_EQ(known.last.lights.size(), 1u);
  EXPECT_FALSE(known.last.lights[0].is_lower_bound());
  EXPECT_LT(luminance(lighting::irradiance(known.last.lights[0], {0, 1, 0})),
            .06f * luminance(c_.world->floor_irradiance()));
}

TEST_F(UnseenSun, IsNoLightOfItsOwnWhereItIsSeenOrBelowTheHorizon) {
  lighting::SunSite night = site();
  night.time = *night.time - std::chrono::hours(12);
  EXPECT_TRUE(watch(night).last.lights.empty());
  fisheye_.world_from_camera.rotation =
      glm::angleAxis(kPi, glm::dvec3(0, 1, 0)) * fisheye_.world_from_camera.rotation;
  const Watched seen = watch(site());
  ASSERT_FALSE(seen.last.lights.empty());
  EXPECT_NE(seen.last.lights[0].id, lighting::kUnseenSun);
}

}  // namespace
}  // namespace penumbra::runtime
