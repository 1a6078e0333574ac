// The composite where light, frame or exposure are extreme, and where everything turns.
#include <gtest/gtest.h>

#include <random>
#include <set>

#include "calib/calib.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/governor/governor_config.h"
#include "runtime/shading/composite_stage.h"
#include "shadows/shadows.h"
#include "tests/stability/maps.h"
#include "tests/stability/series.h"
#include "tools/chart/governor/governor_bench.h"

namespace penumbra::runtime {

using namespace tools;
namespace {

using glm::dvec3;
using test::kDegree, test::kSunRadius;

constexpr int kCompositeWidth = 160, kCompositeHeight = 120;
constexpr dvec3 kUp(0, 1, 0);
constexpr Rgb kWhite{1, 1, 1};

prt::Mesh slab() {
  return prt::make_box({-.3f, 0, -.1f}, {.3f, .5f, .1f}, 8, {.8f, .7f, .6f});
}

// An object on the floor y = 0 (with a shadow in harmonics), or one that floats (lights alone).
PreparedScene scene_of(prt::Mesh mesh, bool receives, Pose pose = {}, double spin_rpm = 0) {
  prt::BakeOptions options;
  options.bands = 5;
  options.bounces = 1;
  options.rays = 256;
  options.ground_rays = 256;
  if (receives)
    options.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 64), {.4f, .4f, .4f}};
  auto baked = prt::bake(std::move(mesh), options);
  EXPECT_TRUE(baked) << baked.error().detail;
  PreparedScene scene;
  scene.objects.push_back({"object", std::move(*baked), pose, spin_rpm});
  scene.planes.push_back({{0, 0, 0}, kUp, {.4f, .4f, .4f}, {}});
  return scene;
}

lighting::LightEstimate estimate_of(const Image<Rgb>& map) {
  auto e = lighting::estimate_map(map, {});
  EXPECT_TRUE(e) << e.error().detail;
  return e ? *e : lighting::LightEstimate{};
}

Image<Rgb> sunny_map() {
  Image<Rgb> map = test::sky_over_ground(512, 256);
  test::add_distant_light(map, test::direction_at(-.6, .7), kDegree, Rgb{2900, 2800, 2400});
  test::add_distant_light(map, test::direction_at(2, .5), 4 * kDegree, {30, 24, 12});
  return map;
}

Image<Rgb> dimmed(Image<Rgb> map, float scale) {
  for (Rgb& c : map.pixels()) c = c * scale;
  return map;
}

class Composite : public testing::Test {
 protected:
  void stand(PreparedScene scene) {
    stage_.reset();
    scene_ = std::move(scene);
    capture::CameraInfo& camera = camera_;
    camera = {};
    camera.vignetting = vignetting_;
    camera.noise_known = noise_.has_value();
    camera.noise = noise_.value_or(calib::NoiseModel{});
    camera.name = "view";
    camera.role = capture::Role::kView;
    camera.projection = {calib::ProjectionKind::kPinhole,
                         kCompositeWidth,
                         kCompositeHeight,
                         {150, 150},
                         {80.5, 59.25}};
    camera.response = calib::Response::srgb();
    curve8_ = capture::make_response_table(camera.response, 8, 0);
    curve16_ = capture::make_response_table(camera.response, 16, 0);
    auto made = CompositeStage::create({camera}, scene_,
                                       compositor::Compositor::Surface::kOffscreen, times_);
    if (!made && made.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1 here: " << made.error().detail;
    ASSERT_TRUE(made) << made.error().detail;
    stage_ = std::move(*made);
  }

  FramePixels composited(FramePixels pixels, const lighting::LightEstimate& light,
                         double seconds = 0, double exposure_s = 1) {
    capture::Frame frame;
    frame.time = TimestampNs{0} + Seconds(seconds);
    frame.exposure = {Seconds(exposure_s), Gain(1)};
    frame.world_from_camera = eye_;
    frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
    auto done = stage_->process(frame, light);
    EXPECT_TRUE(done) << done.error().detail;
    return done ? std::move(done->pixels) : FramePixels{};
  }
  Image<Rgb> composited_floats(const lighting::LightEstimate& light, double seconds = 0) {
    return std::get<Image<Rgb>>(
        composited(Image<Rgb>(kCompositeWidth, kCompositeHeight, kWhite), light, seconds));
  }

  // Where no part of the object is: it would shine under a bright sky.
  std::vector<bool> open_pixels() {
    auto glow = estimate_of(Image<Rgb>(64, 32, {1000, 1000, 1000}));
    const auto a =
        std::get<Image<Rgb>>(composited(Image<Rgb>(kCompositeWidth, kCompositeHeight), glow));
    std::vector<bool> open;
    for (const Rgb& c : a.pixels()) open.push_back(c == Rgb{});
    return open;
  }

  capture::CameraInfo camera_;
  std::array<double, 3> vignetting_{};
  std::optional<calib::NoiseModel> noise_;
  PreparedScene scene_;
  Pose eye_ = capture::look_at({.5, 1.3, 2.2}, {0, .15, 0});
  StageTimes times_;
  std::optional<ResponseTable> curve8_, curve16_;
  std::unique_ptr<CompositeStage> stage_;
};

// Stands the scene up; leaves the test when that was skipped or failed.
#define PENUMBRA_STAND(...) \
  stand(__VA_ARGS__);       \
  if (IsSkipped() || HasFatalFailure()) return

// ------------------------------------------------------------------------------------- colour

TEST_F(Composite, ShadowOfAColouredSunHasTheHueOfTheSky) {
  Image<Rgb> map = test::sky_over_ground(1024, 512, {.2f, .35f, .8f}, {.15f, .12f, .1f});
  const dvec3 sky = test::exact_irradiance(map, kUp);
  const Rgb radiance{46000, 30000, 14000};
  const dvec3 by_sun =
      test::add_distant_light(map, test::direction_at(-.6, .8), kSunRadius, radiance).vector.y *
      dvec3(radiance.r, radiance.g, radiance.b);
  const dvec3 lit = sky + by_sun;
  const double naive = test::luminance_of(sky) / test::luminance_of(lit);
  const auto light = estimate_of(map);
  const Rgb open = open_irradiance(light, kUp);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(open[c] / lit[c], 1, .01) << "lit floor, channel " << c;

  // A plate in the air, beside the picture: what it takes of the sky is not asked for here.
  PENUMBRA_STAND(scene_of(
      prt::make_box({-.4f, 1.6f, -.4f}, {.4f, 1.62f, .4f}, 2, {.5f, .5f, .5f}), false,
      {{1, 0, 0, 0}, {std::sin(-.6) * 1.6 / std::tan(.8), 0, -std::cos(.6) * 1.6 / std::tan(.8)}}));
  const Image<Rgb> out = composited_floats(light);
  Rgb darkest = kWhite;
  double min_colour = 1;
  for (const Rgb& s : out.pixels()) {
    if (luminance(s) < luminance(darkest)) darkest = s;
    // Penumbra: lit and shadowed mixed, so the three ratios lie on one line.
    const double t = (1 - s.g) / (1 - sky.y / lit.y);
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(s[c], 1 - t * (1 - sky[c] / lit[c]), .01 * std::max(.1f, s[c]));
    min_colour = std::min<double>(min_colour, s.r / s.b);
  }
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(darkest[c] / (sky[c] / lit[c]), 1, .01) << "channel " << c;
  }
  std::printf("core of the shadow %.3f %.3f %.3f, closed form %.3f %.3f %.3f, naive %.3f\n",
              double(darkest.r), double(darkest.g), double(darkest.b), sky.x / lit.x, sky.y / lit.y,
              sky.z / lit.z, naive);
  EXPECT_GT(std::abs(naive / (sky.x / lit.x) - 1), .05) << "one ratio for all would do in red";
  EXPECT_GT(std::abs(naive / (sky.z / lit.z) - 1), .05) << "one ratio for all would do in blue";
}

// ------------------------------------------------------------------------------------- no light

TEST(NoLight, MakesNeitherNanNorShadow) {
  const PreparedScene scene = scene_of(slab(), true);
  const Image<Rgb> bright = sunny_map();
  for (const float scale : {0.f, 1e-44f, 1e-41f, 1e-38f, 1e-30f, 1e-12f}) {
    const auto light = lighting::estimate_map(dimmed(bright, scale), {});
    ASSERT_TRUE(light) << scale;
    for (const RadianceSh* l : {&light->light, &light->upper_hemisphere_light})
      for (const Rgb& c : l->terms()) ASSERT_TRUE(is_finite(c)) << scale;
    for (const lighting::DistantLight& d : light->lights) {
      ASSERT_TRUE(is_finite(d.radiance)) << scale;
      ASSERT_NEAR(glm::length(d.direction), 1, 1e-6) << scale;
      ASSERT_TRUE(d.radius.value() >= 0 && d.radius.value() <= kPi) << scale;
    }
    if (scale == 0) {
      EXPECT_TRUE(light->lights.empty());
    }
    const Rgb open = open_irradiance(*light, kUp);
    ASSERT_TRUE(is_finite(open)) << scale;
    // Naive: the ratio of what is left to what there was.
    if (scale == 0) {
      EXPECT_TRUE(std::isnan((open.g - 0) / open.g));
    }
    auto stage = DirectLightStage::create(scene, {});
    ASSERT_TRUE(stage) << stage.error().detail;
    stage->update(light->lights, kPi * luminance(light->mean_radiance), OcclusionProbes(scene));
    std::vector<compositor::ShadowMapOnPlane> on_planes;
    stage->shadows(std::vector<Rgb>{open}, on_planes);
    for (const auto& shadow : on_planes)
      for (int c = 0; c < 3; ++c) ASSERT_TRUE(shadow.part[c] >= 0 && shadow.part[c] <= 1) << scale;
    shadows::ReceiverLight on_floor(light->upper_hemisphere_light);
    for (const lighting::DistantLight& d : light->lights)
      on_floor.distant_irradiance += lighting::irradiance(d, kUp);
    shadows::PlanarShadow shadow;
    ASSERT_TRUE(shadows::compose_planar_shadow(scene.objects[0].baked, on_floor, shadow));
    for (const Rgb& s : shadow.ratio.pixels())
      for (int c = 0; c < 3; ++c) {
        ASSERT_TRUE(s[c] >= 0 && s[c] <= 1.5f) << scale;
        if (scale == 0) {
          ASSERT_EQ(s[c], 1);
        }
      }
  }
}

TEST_F(Composite, WithoutLightTheFloorKeepsItsBytes) {
  PENUMBRA_STAND(scene_of(slab(), true));
  const std::vector<bool> open = open_pixels();
  Image<Rgb8> frame(kCompositeWidth, kCompositeHeight);
  for (std::size_t i = 0; i < frame.area(); ++i)
    frame.pixels()[i] = {std::uint8_t(i), std::uint8_t(i / 7), std::uint8_t(255 - i % 256)};
  const Image<Rgb> bright = sunny_map();
  const auto changed_under = [&](float scale) {
    const auto out = std::get<Image<Rgb8>>(composited(frame, estimate_of(dimmed(bright, scale))));
    int changed = 0;
    for (std::size_t i = 0; i < frame.area(); ++i)
      changed += open[i] && !(out.pixels()[i] == frame.pixels()[i]);
    return changed;
  };
  const int shadowed = changed_under(1);
  EXPECT_GT(shadowed, 500) << "there is a shadow to lose";
  EXPECT_EQ(changed_under(0), 0);
  EXPECT_NEAR(changed_under(1), shadowed, 0) << "and it comes back with the light";
  EXPECT_NEAR(changed_under(1e-9f), shadowed, .02 * shadowed) << "the ratio has no scale";
}

// ------------------------------------------------------------------------------------- codes

TEST_F(Composite, BlackStaysBlackAndBlownOutStaysInRange) {
  PENUMBRA_STAND(scene_of(slab(), true));
  const std::vector<bool> open = open_pixels();
  // A low sun that the slab throws back onto the floor before it: ratios above one.
  Image<Rgb> map = test::sky_over_ground(512, 256, {.1f, .12f, .2f}, {.02f, .02f, .02f});
  test::add_distant_light(map, test::direction_at(2.3, .35), kDegree, {3000, 3000, 3000});
  const auto light = estimate_of(map);
  const Image<Rgb> ratio = composited_floats(light);
  const auto run = [&](std::uint8_t code) {
    return std::get<Image<Rgb8>>(
        composited(Image<Rgb8>(kCompositeWidth, kCompositeHeight, {code, code, code}), light));
  };
  const Image<Rgb8> black = run(0), blown = run(255);
  int brighter = 0, darker = 0, wrapped = 0, below_black = 0;
  for (std::size_t i = 0; i < black.area(); ++i) {
    const Rgb s = ratio.pixels()[i];
    ASSERT_TRUE(is_finite(s));
    if (!open[i]) continue;
    ASSERT_EQ(black.pixels()[i], Rgb8()) << i;
    // Naive: what the object takes subtracted (eq. 8.4 of the dissertation), back into a byte.
    const double taken = (1 - s.g) * .4 * luminance(open_irradiance(light, kUp)) / kPi;
    below_black += static_cast<std::uint8_t>(int(-255 * taken)) > 100;
    const std::uint8_t out[3] = {blown.pixels()[i].r, blown.pixels()[i].g, blown.pixels()[i].b};
    for (int c = 0; c < 3; ++c) {
      // A clipped pixel is at least full scale: it is shaded from there, and clipped again.
      ASSERT_NEAR(out[c], curve8_->encode(c, std::min(1.f, s[c])), 1) << i << ' ' << s[c];
      if (s[c] >= 1) {
        ASSERT_EQ(out[c], 255) << i;
      }
      // Naive: the product back into a byte.
      wrapped += s[c] > 1.01f && static_cast<std::uint8_t>(int(255 * s[c])) < 128;
    }
    brighter += s.g > 1.01f, darker += s.g < .9f;
  }
  EXPECT_GT(brighter, 50) << "no ratio above one to clip";
  EXPECT_GT(darker, 300);
  EXPECT_GT(wrapped, 50) << "the naive byte would do";
  EXPECT_GT(below_black, 300) << "a difference would do";
}

// Where the floor is known to be brighter than the sensor can say, its shadow is a part of that.
class BlownOutFloor : public Composite {
 protected:
  // How many codes of a picture at full scale are told apart from those shaded from full scale;
  // `sends`: times full scale.
  struct Seen {
    int shaded = 0, brighter = 0;
  };
  Seen look(double sends) {
    const auto light = estimate_of(sunny_map());
    composited_floats(light);  // what things send to each other is a frame late
    const Image<Rgb> ratio = composited_floats(light);
    const Rgb floor = open_irradiance(light, kUp) * float(.4 / kPi);  // radiance, of albedo .4
    const double exposure_s = sends / double(std::min({floor.r, floor.g, floor.b}));
    const auto out = std::get<Image<Rgb8>>(composited(
        Image<Rgb8>(kCompositeWidth, kCompositeHeight, {255, 255, 255}), light, 0, exposure_s));
    const auto out16 = std::get<Image<Rgb16>>(
        composited(Image<Rgb16>(kCompositeWidth, kCompositeHeight, {65535, 65535, 65535}), light, 0,
                   exposure_s));
    Seen seen;
    for (std::size_t i = 0; i < out.area(); ++i) {
      if (!open_[i]) continue;
      const Rgb s = ratio.pixels()[i];
      const std::uint8_t got[3] = {out.pixels()[i].r, out.pixels()[i].g, out.pixels()[i].b};
      const std::uint16_t got16[3] = {out16.pixels()[i].r, out16.pixels()[i].g,
                                      out16.pixels()[i].b};
      for (int c = 0; c < 3; ++c) {
        const float full = std::max(1.f, known_ * floor[c] * float(exposure_s));
        EXPECT_NEAR(got[c], curve8_->encode(c, std::min(1.f, s[c] * full)), 1) << i;
        EXPECT_NEAR(got16[c], curve16_->encode(c, std::min(1.f, s[c] * full)), 64) << i;
        seen.shaded += s[c] < .9f;
        seen.brighter += got[c] - int(curve8_->encode(c, std::min(1.f, s[c]))) > 40;
      }
    }
    return seen;
  }

  std::vector<bool> open_;
  float known_ = 1;  // fraction of the floor's light that is counted on
};

TEST_F(BlownOutFloor, ShadowStartsFromWhatTheFloorReallySends) {
  PENUMBRA_STAND(scene_of(slab(), true));
  open_ = open_pixels();
  const Seen dim = look(.5), bright = look(1.5), brightest = look(2.5);
  EXPECT_GT(dim.shaded, 900);
  EXPECT_EQ(dim.brighter, 0) << "what clips beside a floor that does not is at full scale";
  // Naive: shaded from full scale.
  EXPECT_GT(bright.brighter, 300);
  EXPECT_GT(brightest.brighter, 300);
}

TEST_F(BlownOutFloor, IsAtFullScaleWhereItsLightIsNotKnown) {
  known_ = 0;
  PreparedScene unknown = scene_of(slab(), true), beside = unknown;
  unknown.planes[0].albedo = {};
  beside.planes.push_back({{0, 0, -9}, {0, 0, 1}, {.4f, .4f, .4f}, {}});
  for (const PreparedScene* scene : {&unknown, &beside}) {
    PENUMBRA_STAND(*scene);
    open_ = open_pixels();
    EXPECT_EQ(look(2.5).brighter, 0);
  }
}

TEST_F(BlownOutFloor, CountsOnTheDarkestCornerOfTheLens) {
  vignetting_ = {-.3, 0, 0};
  PENUMBRA_STAND(scene_of(slab(), true));
  const calib::CameraModel& p = camera_.projection;
  known_ = float(calib::min_fraction(calib::vignetting_of(p, vignetting_), p));
  EXPECT_NEAR(known_, .7, .02);
  open_ = open_pixels();
  EXPECT_GT(look(2.5).brighter, 300);
}

// The same under the camera's look: noise of a shadow on such a floor is that of its own signal.
TEST_F(BlownOutFloor, KeepsItsShadowUnderTheCamerasNoise) {
  PENUMBRA_STAND(scene_of(slab(), true));
  const std::vector<bool> open = open_pixels();
  const auto light = estimate_of(sunny_map());
  const Image<Rgb> ratio = composited_floats(light);
  noise_ = {20000, 1e-3};
  PENUMBRA_STAND(scene_of(slab(), true));
  const Rgb floor = open_irradiance(light, kUp) * float(.4 / kPi);
  const double exposure_s = 1.5 / double(floor.g);
  const auto out = std::get<Image<Rgb8>>(composited(
      Image<Rgb8>(kCompositeWidth, kCompositeHeight, {255, 255, 255}), light, 0, exposure_s));
  int judged = 0;
  double off = 0, naive = 0;
  for (std::size_t i = 0; i < out.area(); ++i) {
    const float s = ratio.pixels()[i].g;
    if (!open[i] || s > .8f) continue;
    off += out.pixels()[i].g - double(curve8_->encode(1, s * 1.5f));
    naive += curve8_->encode(1, s) - double(curve8_->encode(1, s * 1.5f));
    ++judged;
  }
  ASSERT_GT(judged, 100);
  EXPECT_NEAR(off / judged, 0, 1);
  EXPECT_LT(naive / judged, -20);
}

TEST_F(Composite, ShadowRatioDoesNotFollowTheExposureOfTheFeed) {
  PENUMBRA_STAND(scene_of(slab(), true));
  const std::vector<bool> open = open_pixels();
  const auto light = estimate_of(sunny_map());
  // The same floor at two exposures, in 8 and 16 bits; the frame says which was applied.
  constexpr double kExposure = .01;
  const auto radiance = [](int x, int y) { return 30 + .2f * float(x) + .1f * float(y); };
  const auto shot = [&](auto pixel, const ResponseTable& curve, double exposure) {
    Image<decltype(pixel)> frame(kCompositeWidth, kCompositeHeight);
    using Code = decltype(pixel.r);
    for (int y = 0; y < kCompositeHeight; ++y)
      for (int x = 0; x < kCompositeWidth; ++x) {
        const auto signal = static_cast<float>(exposure) * radiance(x, y);
        frame.at(x, y) = {static_cast<Code>(curve.encode(0, signal)),
                          static_cast<Code>(curve.encode(1, signal)),
                          static_cast<Code>(curve.encode(2, signal))};
      }
    return frame;
  };
  const auto check = [&](auto pixel, const ResponseTable& curve) {
    using Frame = Image<decltype(pixel)>;
    const Frame full = shot(pixel, curve, kExposure), half = shot(pixel, curve, kExposure / 2);
    const auto full_out = std::get<Frame>(composited(full, light, 0, kExposure)),
               half_out = std::get<Frame>(composited(half, light, 0, kExposure / 2));
    double worst = 0, naive_worst = 0;
    int shaded = 0;
    for (std::size_t i = 0; i < full.area(); ++i) {
      const auto linear = [&](const Frame& f) { return double(curve.decode(1, f.pixels()[i].g)); };
      // Half a step on either side, in and out.
      const auto step = [&](const Frame& f) {
        const unsigned code = f.pixels()[i].g;
        return .5 *
               (curve.decode(1, std::min(code + 1, curve.largest_code())) -
                curve.decode(1, code > 0 ? code - 1 : 0)) /
               2;
      };
      if (!open[i]) continue;  // what is drawn follows the exposure, and the rim mixes both
      const double s_full = linear(full_out) / linear(full),
                   s_half = linear(half_out) / linear(half);
      const double allowed = 1.1 * ((step(full_out) + step(full)) / linear(full) +
                                    (step(half_out) + step(half)) / linear(half));
      worst = std::max(worst, std::abs(s_full - s_half) - allowed);
      // Naive: the shadow as a signal to take off, as it was before the step.
      const double naive = (linear(half) - (linear(full) - linear(full_out))) / linear(half);
      naive_worst = std::max(naive_worst, std::abs(s_full - naive) - allowed);
      shaded += s_full < .7;
    }
    std::printf("exposure: ratio off by %.4f beyond quantisation, naive by %.2f\n", worst,
                naive_worst);
    EXPECT_GT(shaded, 300);
    EXPECT_LE(worst, 0);
    EXPECT_GT(naive_worst, .2);
  };
  check(Rgb8{}, *curve8_);
  check(Rgb16{}, *curve16_);
}

TEST_F(Composite, DrawnObjectFollowsTheExposureOfTheFeed) {
  PENUMBRA_STAND(scene_of(slab(), true));
  const auto light = estimate_of(sunny_map());
  const Image<Rgb> black(kCompositeWidth, kCompositeHeight);
  const auto full = std::get<Image<Rgb>>(composited(black, light, 0, .01)),
             half = std::get<Image<Rgb>>(composited(black, light, 0, .005));
  int drawn = 0;
  for (std::size_t i = 0; i < black.area(); ++i) {
    drawn += full.pixels()[i].g > 0;
    for (int c = 0; c < 3; ++c)  // half floats on the way, whose steps near 0 are 2^-24
      ASSERT_NEAR(half.pixels()[i][c], .5f * full.pixels()[i][c],
                  std::max(1e-3f * full.pixels()[i][c], 0x1p-25f));
  }
  EXPECT_GT(drawn, 500);
}

// ------------------------------------------------------------------------------------- yaw

double largest_difference(const Image<Rgb>& a, const Image<Rgb>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.area(); ++i)
    for (int c = 0; c < 3; ++c) {
      const double x = a.pixels()[i][c], y = b.pixels()[i][c];
      const double d = std::abs(x - y) / std::max({.1, x, y});
      if (!(d <= largest)) largest = d;  // NaN is the largest of all
    }
  return largest;
}

// RMS over the picture, relative to its mean.
double rms_difference(const Image<Rgb>& a, const Image<Rgb>& b) {
  double sum = 0, all = 0;
  for (std::size_t i = 0; i < a.area(); ++i) {
    sum += std::pow(luminance(a.pixels()[i]) - luminance(b.pixels()[i]), 2);
    all += luminance(b.pixels()[i]);
  }
  const auto area = static_cast<double>(a.area());
  return std::sqrt(sum / area) / (all / area);
}

TEST_F(Composite, YawOfAWholeTurnCloses) {
  constexpr double kRpm = 10;  // a turn in six seconds
  for (const int max_lights : {8, 0}) {
    PENUMBRA_STAND(scene_of(slab(), true, {}, kRpm));
    lighting::EstimateOptions options;
    options.lights.max_count = max_lights;
    const auto light = lighting::estimate_map(sunny_map(), options);
    ASSERT_TRUE(light);
    ASSERT_EQ(light->lights.empty(), max_lights == 0);
    const Image<Rgb> first = composited_floats(*light, 0);
    double moved = 0;
    for (int step = 1; step < 48; ++step)
      moved = std::max(moved, largest_difference(composited_floats(*light, step * 6. / 48), first));
    const double closed = largest_difference(composited_floats(*light, 6), first);
    // Naive: what is kept from the last pose that was drawn.
    const double naive = largest_difference(composited_floats(*light, 6 * 47. / 48), first);
    std::printf("%d lights at most: a turn closes to %.1e, moved %.2f on the way, naive %.2f\n",
                max_lights, closed, moved, naive);
    EXPECT_LE(closed, 1e-3);
    EXPECT_GT(moved, .1);
    EXPECT_GT(naive, 1e-3);
  }
}

// All of the world turned about the vertical by a number of the map's columns.
Image<Rgb> turned_map(const Image<Rgb>& map, int columns) {
  Image<Rgb> out(map.width(), map.height());
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      out.at((x - columns + map.width()) % map.width(), y) = map.at(x, y);
  return out;
}

TEST_F(Composite, LightTurnedWithTheObjectChangesNothing) {
  const Image<Rgb> map = sunny_map();
  const Pose eye = eye_;
  PENUMBRA_STAND(scene_of(slab(), true));
  const Image<Rgb> straight = composited_floats(estimate_of(map));
  for (const int columns : {37, 128, 300}) {
    const Pose turn{glm::angleAxis(2 * kPi * columns / map.width(), kUp), {0, 0, 0}};
    PreparedScene scene = std::move(scene_);
    scene.objects[0].world_from_bake = turn;
    stage_.reset();
    PENUMBRA_STAND(std::move(scene));
    eye_ = turn * eye;
    const auto light = estimate_of(turned_map(map, columns));
    const Image<Rgb> turned = composited_floats(light);
    // Naive: the light stays as it was in the object's frame.
    const Image<Rgb> naive = composited_floats(estimate_of(map));
    double largest = 0;
    for (std::size_t i = 0; i < turned.area(); ++i)
      for (int c = 0; c < 3; ++c)
        largest =
            std::max<double>(largest, std::abs(turned.pixels()[i][c] - straight.pixels()[i][c]));
    std::printf("turned by %d columns: %.2f %% RMS, %.3f at most; naive %.1f %% RMS\n", columns,
                100 * rms_difference(turned, straight), largest,
                100 * rms_difference(naive, straight));
    EXPECT_LE(rms_difference(turned, straight), .01);
    // Rounding decides which cells of a shadow's edge are traced finer, each worth up to .09.
    EXPECT_LE(largest, .1);
    EXPECT_GT(rms_difference(naive, straight), .05);
  }
}

// ------------------------------------------------------------------------------- ten minutes

// Governed light of a camera's noisy maps, all the way to the picture.
TEST_F(Composite, TenMinutesOfOneSceneStandStill) {
  PENUMBRA_STAND(scene_of(slab(), true));
  constexpr int kMaps = 1000;
  constexpr float kNoise = .03f;
  Image<Rgb> scene = test::sky_over_ground(128, 64);
  test::add_distant_light(scene, test::direction_at(.5, .8), 6 * kDegree, {90, 85, 70});
  test::add_distant_light(scene, test::direction_at(-2, .4), 4 * kDegree, {90, 85, 70});
  lighting::LightEstimator estimator({});
  estimator.set_governor({{}, {}, scene_probes(scene_, 5)});
  const std::vector<bool> open = open_pixels();
  std::mt19937 random(7);
  std::normal_distribution<float> gauss(1, kNoise);
  test::Series shadow, object, naive;
  std::set<std::pair<int, int>> plans;
  Image<Rgb> before;
  double pixel_changes = 0, largest = 0;
  std::vector<std::size_t> shaded;
  for (int i = 0; i < kMaps; ++i) {
    Image<Rgb> map = scene;
    for (Rgb& c : map.pixels()) c = c * gauss(random);
    const auto brightest =
        std::ranges::max_element(map.pixels(), {}, [](const Rgb& c) { return luminance(c); });
    naive.values.push_back(luminance(*brightest));  // as one hard light takes it
    const auto light = estimator.estimate(
        test::environment_at(std::move(map), std::int64_t{600'000'000'000} / kMaps * i));
    ASSERT_TRUE(light && light->plan);
    plans.emplace(light->plan->bands, light->plan->lights);
    const Image<Rgb> picture = composited_floats(*light, .6 * i);
    if (i == 0) {
      before = picture;
      for (std::size_t p = 0; p < picture.area(); ++p)
        if (open[p] && luminance(picture.pixels()[p]) < .9f) shaded.push_back(p);
    }
    double left = 0, seen = 0;
    for (const std::size_t p : shaded) {
      const double now = luminance(picture.pixels()[p]),
                   change = now - double(luminance(before.pixels()[p]));
      left += now, pixel_changes += change * change;
      largest = std::max(largest, std::abs(change));
    }
    for (std::size_t p = 0; p < picture.area(); ++p)
      if (!open[p]) seen += double(luminance(picture.pixels()[p]));
    shadow.values.push_back(left / double(shaded.size()));
    object.values.push_back(seen);
    before = picture;
  }
  const double pixel =
      std::sqrt(pixel_changes / (double(shaded.size()) * (kMaps - 1))) / shadow.mean();
  std::printf(
      "ten minutes: shadow %.3f %%, its pixels %.3f %%, at most %.3f in s, object %.3f %%, "
      "brightest pixel %.1f %%\n",
      100 * shadow.flicker(), 100 * pixel, largest, 100 * object.flicker(), 100 * naive.flicker());
  ASSERT_GT(shaded.size(), 300U);
  EXPECT_EQ(plans.size(), 1U) << "the governor wavers";
  expect_no_drift(shadow, "shadow");
  expect_no_drift(object, "object");
  EXPECT_LT(shadow.flicker(), .1 * double(kNoise));
  EXPECT_LT(object.flicker(), .25 * double(kNoise));
  EXPECT_LT(pixel, .4 * double(kNoise));
  EXPECT_LT(largest, .03) << "a shadow pops";
  EXPECT_GT(naive.flicker(), .3 * double(kNoise)) << "the brightest pixel would do";
}

}  // namespace
}  // namespace penumbra::runtime
