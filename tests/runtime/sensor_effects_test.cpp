// What the studio's camera does to a real wall, the pipeline does to an inserted one.
#include <gtest/gtest.h>

#include <cmath>

#include "calib/calib.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "runtime/shading/composite_stage.h"
#include "tests/support/leaning_wall.h"

namespace penumbra::runtime {
namespace {

constexpr int kSensorWidth = 120, kSensorHeight = 80;
constexpr double kLean = .09, kFocal = 100;

/// Whether a white wall 2 m ahead, right of a leaning edge, stands there; else it is dark.
class WallWorld : public capture::RadianceWorld {
 public:
  explicit WallWorld(bool stands) : stands_(stands) {}
  Rgb radiance(const glm::dvec3&, const glm::dvec3& d) const override {
    const bool seen = d.z < 0 && d.x * std::cos(kLean) - d.y * std::sin(kLean) > 0;
    return stands_ && seen ? Rgb{1, 1, 1} : Rgb{};
  }
  Rgb far_radiance(const glm::dvec3&) const override { return {1, 1, 1}; }

 private:
  bool stands_;
};

PreparedScene wall_scene() {
  PreparedScene scene;
  scene.objects.push_back({"wall", test::leaning_wall(kLean), {}, 0});
  return scene;
}

/// What inserts the wall into the pictures of these cameras.
Result<std::unique_ptr<CompositeStage>> wall_stage(const std::vector<capture::CameraInfo>& cameras,
                                                   StageTimes& times) {
  static const PreparedScene scene = wall_scene();
  return CompositeStage::create(cameras, scene, compositor::Compositor::Surface::kOffscreen, times,
                                4);
}

lighting::LightEstimate white_light() {
  return lighting::make_estimate(
      *lighting::project_latlong(Image<Rgb>(64, 32, {1, 1, 1}), kMaxBands), 3);
}

capture::StudioOptions studio_options(int bits, double psf, Exposure exposure) {
  capture::StudioOptions o;
  o.environment_width = 32, o.environment_height = 16;
  o.view_width = kSensorWidth, o.view_height = kSensorHeight;
  o.view_focal_px = kFocal;
  o.schedule = {{Seconds(.5), Gain(1)}};
  o.view_exposure = exposure;
  o.view_frames = 24;
  o.sensor.response = calib::Response::srgb();
  o.sensor.noise = {4000, 1e-3};
  o.sensor.bits = bits;
  o.sensor.psf_sigma_px = psf;
  return o;
}

/// Mean and variance over the frames of a clip, green, in signal.
struct Clip {
  std::vector<double> mean = std::vector<double>(kSensorWidth * kSensorHeight), variance = mean;
  double count = 0;

  void add(const FramePixels& pixels, const calib::Response& response) {
    ++count;
    for (std::size_t i = 0; i < mean.size(); ++i) {
      const auto* f8 = std::get_if<Image<Rgb8>>(&pixels);
      const double code =
          f8 ? f8->pixels()[i].g / 255. : std::get<Image<Rgb16>>(pixels).pixels()[i].g / 65535.;
      const double y = response.decode(code, 1), off = y - mean[i];
      mean[i] += off / count;
      variance[i] += off * (y - mean[i]);
    }
  }
  double average(const std::vector<double>& of, double per) const {  // of the wall's inside
    double sum = 0;
    for (int y = 0; y < kSensorHeight; ++y)
      for (int x = kSensorWidth - 30; x < kSensorWidth; ++x)
        sum += of[std::size_t(y * kSensorWidth + x)];
    return sum / (30. * kSensorHeight) / per;
  }
  double level() const { return average(mean, 1); }
  double noise() const { return average(variance, count - 1); }
  /// From 10 to 90 % of the level across the edge, pixels.
  double edge_width() const {
    std::vector<double> sum(128), n(128);
    for (int y = 0; y < kSensorHeight; ++y)
      for (int x = 0; x < kSensorWidth; ++x) {
        const double d = (x + .5 - kSensorWidth / 2.) * std::cos(kLean) +
                         (y + .5 - kSensorHeight / 2.) * std::sin(kLean);
        const double bin = (d + 8) * 8;
        if (bin < 0 || bin >= 128) continue;
        sum[std::size_t(bin)] += mean[std::size_t(y * kSensorWidth + x)] / level();
        n[std::size_t(bin)] += 1;
      }
    const auto crossing = [&](double at) {
      for (std::size_t i = 1; i < sum.size(); ++i) {
        const double before = sum[i - 1] / n[i - 1], here = sum[i] / n[i];
        if (before < at && here >= at) return (double(i) + (at - before) / (here - before)) / 8;
      }
      return std::nan("");
    };
    return crossing(.9) - crossing(.1);
  }
};

/// Every view frame of a studio, as it is or with the wall inserted.
Result<Clip> film(const capture::StudioOptions& options, bool inserted, bool with_effects = true) {
  capture::Studio studio(std::make_shared<WallWorld>(!inserted), options);
  std::vector<capture::CameraInfo> cameras = studio.cameras();
  if (!with_effects) cameras[1].noise_known = false, cameras[1].psf_sigma_px = 0;
  StageTimes times;
  std::unique_ptr<CompositeStage> stage;
  if (inserted) {
    PENUMBRA_ASSIGN(made, wall_stage(cameras, times));
    stage = std::move(made);
  }
  const lighting::LightEstimate light = white_light();
  Clip clip;
  for (;;) {
    PENUMBRA_ASSIGN(frame, studio.next());
    if (!frame) return clip;
    if (frame->camera != 1) continue;
    if (!stage) {
      clip.add(*frame->pixels, options.sensor.response);
      continue;
    }
    PENUMBRA_ASSIGN(out, stage->process(*frame, light));
    clip.add(out.pixels, options.sensor.response);
  }
}

TEST(SensorEffects, InsertedWallIsAsNoisyAndAsSoftAsARealOne) {
  for (const int bits : {8, 16})
    for (const auto& [exposure, psf] : {std::pair{Exposure{Seconds(.02), Gain(1)}, .7},
                                        {Exposure{Seconds(.2), Gain(1)}, 1.},
                                        {Exposure{Seconds(.6), Gain(1)}, 2.},
                                        {Exposure{Seconds(.025), Gain(8)}, 1.}}) {
      const auto options = studio_options(bits, psf, exposure);
      const auto ours = film(options, true);
      if (!ours && ours.error().code == ErrorCode::kUnavailable)
        GTEST_SKIP() << "no OpenGL ES 3.1 here: " << ours.error().detail;
      const auto real = film(options, false), naive = film(options, true, false);
      ASSERT_TRUE(ours && real && naive);
      std::printf(
          "%d bits, signal %.2f, gain %g, sigma %.1f: variance %.3f of the real wall's (naive "
          "%.3f), edge %.2f pixels (real %.2f, naive %.2f)\n",
          bits, exposure.product(), exposure.gain.value(), psf, ours->noise() / real->noise(),
          naive->noise() / real->noise(), ours->edge_width(), real->edge_width(),
          naive->edge_width());
      EXPECT_NEAR(ours->level() / real->level(), 1, .01);
      EXPECT_NEAR(ours->noise() / real->noise(), 1, .1);
      EXPECT_LT(naive->noise(), .1 * real->noise()) << "what is tested is seen";
      EXPECT_NEAR(ours->edge_width() / real->edge_width(), 1, .1);
      EXPECT_LT(naive->edge_width(), .85 * real->edge_width()) << "what is tested is seen";
    }
}

// Mean codes of the wall's inside.
std::array<double, 3> colour_of(const FramePixels& pixels) {
  std::array<double, 3> sum{};
  const auto& image = std::get<Image<Rgb16>>(pixels);
  for (int y = 0; y < kSensorHeight; ++y)
    for (int x = kSensorWidth - 30; x < kSensorWidth; ++x) {
      const Rgb16& p = image.at(x, y);
      sum[0] += p.r, sum[1] += p.g, sum[2] += p.b;
    }
  for (double& s : sum) s /= 30. * kSensorHeight;
  return sum;
}

TEST(SensorEffects, InsertedWallHasTheWhiteBalanceOfTheCamera) {
  auto options = studio_options(16, 0, {Seconds(.2), Gain(1)});
  options.sensor.noisy = false;
  options.sensor.response = *options.sensor.response.with_white_balance({2, 1, 1.5});
  std::array<double, 3> seen[2];
  for (const bool inserted : {false, true}) {
    capture::Studio studio(std::make_shared<WallWorld>(!inserted), options);
    StageTimes times;
    auto stage = wall_stage(studio.cameras(), times);
    if (!stage && stage.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1 here: " << stage.error().detail;
    auto light = *LightEstimationStage::create(studio.cameras(), {3, {0, .02}}, times);
    const auto environment = *studio.next(), view = *studio.next();
    ASSERT_TRUE(environment && view);
    const auto measured = light.process(*environment);
    ASSERT_TRUE(measured);
    const Rgb& mean = measured->mean_radiance;
    EXPECT_NEAR(mean.r / mean.g, 1, .01) << "white light stays white in the measurement";
    seen[inserted] =
        colour_of(inserted ? (*stage)->process(*view, *measured)->pixels : *view->pixels);
  }
  EXPECT_GT(seen[0][0], 1.2 * seen[0][1]) << "what is tested is seen";
  for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(seen[1][c] / seen[0][c], 1, .01) << c;
}

TEST(SensorEffects, NoNoiseIsInventedForACameraThatNobodyMeasured) {
  auto options = studio_options(16, 0, {Seconds(.3), Gain(1)});
  options.sensor.noisy = false;
  const auto clip = film(options, true);
  if (!clip && clip.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << clip.error().detail;
  ASSERT_TRUE(clip);
  for (const double v : clip->variance) ASSERT_EQ(v, 0);
}

}  // namespace
}  // namespace penumbra::runtime
