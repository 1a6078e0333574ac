// The schedule that follows the light: as few exposures as its error allows, within the sensor's
// limits.
#include "capture/device/internal/exposure_schedule.h"
#include "calib/calib.h"
#include "capture/capture.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <numeric>

#include "capture/device/internal/bracketed_camera.h"
#include "core/conventions.h"
#include "core/half.h"
#include "tests/support/brackets.h"
#include "tests/support/fake_camera.h"

namespace penumbra::capture {
namespace {

constexpr int kScheduleWidth = 384, kScheduleHeight = 192;
constexpr double kFps = 30;

CameraInfo camera_info() {
  CameraInfo out;
  out.name = "environment";
  out.projection =
      *calib::make_projection(calib::ProjectionKind::kLatLong, kScheduleWidth, kScheduleHeight);
  out.response = calib::Response::srgb();
  return out;
}

/// Scaled to a mean luminance in full scales a second.
Image<Rgb> scaled(Image<Rgb> map, double mean) {
  double sum = 0, area = 0;
  for (int y = 0; y < map.height(); ++y)
    for (const Rgb& p : map.row(y)) {
      const double w = latlong_solid_angle(y, map.width(), map.height());
      sum += w * static_cast<double>(luminance(p));
      area += w;
    }
  const auto scale = static_cast<float>(mean * area / sum);
  for (Rgb& p : map.pixels()) p = p * scale;
  return map;
}

/// Its sun over some twenty pixels, as a lens shows it.
Image<Rgb> clear_sky() {
  Image<Rgb> map = make_sky_environment(kScheduleWidth, kScheduleHeight, .8);
  blur(map, 1.5);
  return scaled(std::move(map), 2);
}

/// Irradiance's relative error of what `exposures` (any order) make of a scene; the worst of six
/// directions.
double irradiance_error(const Image<Rgb>& scene, const std::vector<Exposure>& exposures,
                        std::uint64_t seed) {
  Sensor sensor;
  sensor.response = calib::Response::srgb();
  const auto merged = merge(test::bracket(sensor, scene, exposures, seed));
  EXPECT_TRUE(merged);
  if (!merged) return 1;
  double worst = 0;
  for (const glm::dvec3 normal :
       {glm::dvec3(0, 1, 0), {0, -1, 0}, {1, 0, 0}, {-1, 0, 0}, {0, 0, 1}, {0, 0, -1}}) {
    double right = 0, ours = 0;
    for (int y = 0; y < kScheduleHeight; ++y)
      for (int x = 0; x < kScheduleWidth; ++x) {
        const double w =
            latlong_solid_angle(y, kScheduleWidth, kScheduleHeight) *
            std::max(0., glm::dot(normal, latlong_direction(x + .5, y + .5, kScheduleWidth,
                                                            kScheduleHeight)));
        right += w * static_cast<double>(luminance(scene.at(x, y)));
        ours += w * static_cast<double>(luminance(merged->radiance.at(x, y)));
      }
    worst = std::max(worst, std::abs(ours / right - 1));
  }
  return worst;
}

struct Followed {
  std::vector<Exposure> exposures;  // in the end
  double promised = 1;
  std::vector<std::size_t> changes;  // frames at which a new schedule was asked for
  int frames = 0;
};
Followed run(const Image<Rgb>& scene, double budget, int frames,
             const std::function<double(double)>& light = {}) {
  test::FakeCameraBehaviour behaviour;
  behaviour.light = light;
  BracketedCamera camera(camera_info(), {}, 2, budget, kFps);
  EXPECT_TRUE(camera.connect(std::make_unique<test::FakeCamera>(scene, behaviour)));
  Followed out;
  for (int n = 0; n < frames; ++n) {
    const auto frame = camera.next(Seconds(.1));
    EXPECT_TRUE(frame);
    if (!frame || !*frame) continue;
    ++out.frames;
    const auto same = [](const Exposure& a, const Exposure& b) {
      return a.time == b.time && a.gain == b.gain;
    };
    if (!std::ranges::equal(out.exposures, camera.counts().exposures, same))
      out.changes.push_back(static_cast<std::size_t>(n));
    out.exposures = camera.counts().exposures;
    out.promised = camera.counts().light_error.value_or(1);
  }
  return out;
}

TEST(ExposureSchedule, FewestThatKeepTheIrradianceWithinItsBudget) {
  struct Case {
    const char* name;
    Image<Rgb> scene;
    std::size_t max_at_five, max_at_one;  // exposures, at a budget of so many per cent
  };
  const Case cases[] = {
      {"overcast", scaled(Image<Rgb>(kScheduleWidth, kScheduleHeight, {1, 1, 1}), 20), 1, 1},
      {"room", scaled(make_room_environment(kScheduleWidth, kScheduleHeight), 20), 1, 2},
      {"clear sky", clear_sky(), 2, 5},
      {"dim room", scaled(make_room_environment(kScheduleWidth, kScheduleHeight), 1), 1, 2},
  };
  for (const Case& c : cases)
    for (const double budget : {.05, .01}) {
      const Followed r = run(c.scene, budget, 120);
      double square = 0;
      constexpr int kRuns = 5;
      for (std::uint64_t seed = 0; seed < kRuns; ++seed)
        square += std::pow(irradiance_error(c.scene, r.exposures, 3 + seed), 2) / kRuns;
      const double error = std::sqrt(square);
      std::printf("%-10s budget %.2f: %zu exposures", c.name, budget, r.exposures.size());
      for (const Exposure& e : r.exposures)
        std::printf(" %.3g ms x %.2g", 1e3 * e.time.count(), e.gain.value());
      std::printf(", promised %.4f, irradiance off by %.4f\n", r.promised, error);
      EXPECT_LE(r.exposures.size(), budget > .02 ? c.max_at_five : c.max_at_one) << c.name;
      EXPECT_LE(error, budget) << c.name;
      EXPECT_LE(r.promised, budget) << c.name;
      for (const Exposure& e : r.exposures) {
        EXPECT_GE(e.time.count(), 1e-5 * .999);
        EXPECT_LE(e.time.count(), 1 / kFps);
      }
    }
}

TEST(ExposureSchedule, OneExposureLessWouldNotDo) {
  const Image<Rgb> scene = clear_sky();
  const double budget = .01;
  const Followed r = run(scene, budget, 120);
  ASSERT_GT(r.exposures.size(), 1u);
  double best = 1;
  for (double t = 1e-5; t < 1 / kFps; t *= 1.2)
    best = std::min(best, irradiance_error(scene, {{Seconds(t), Gain(1)}}, 5));
  std::printf("best single exposure: irradiance off by %.4f\n", best);
  EXPECT_GT(best, 10 * budget);
}

TEST(ExposureSchedule, FollowsALampWithinOneRing) {
  const Image<Rgb> scene = scaled(make_room_environment(kScheduleWidth, kScheduleHeight), 5);
  const double change_s = 3;
  for (const double factor : {20., .02}) {
    const Followed before = run(scene, .01, static_cast<int>(change_s * kFps) - 5);
    const auto light = [&](double t) { return t < change_s ? 1. : factor; };
    const Followed r = run(scene, .01, 240, light);
    const auto changed = static_cast<std::size_t>(change_s * kFps) - 1;  // frames count from 0
    const auto first = std::ranges::find_if(r.changes, [&](std::size_t n) { return n >= changed; });
    if (first == r.changes.end()) {
      Image<Rgb> now = scene;
      for (Rgb& p : now.pixels()) p = p * static_cast<float>(factor);
      EXPECT_LE(irradiance_error(now, before.exposures, 3), .01) << "nothing had to change";
      continue;
    }
    std::printf(
        "light times %g: new schedule after %td frames, of a ring of %zu; at last %zu exposures, "
        "promised %.4f\n",
        factor, static_cast<std::ptrdiff_t>(*first) - static_cast<std::ptrdiff_t>(changed),
        before.exposures.size(), r.exposures.size(), r.promised);
    Image<Rgb> after = scene;
    for (Rgb& p : after.pixels()) p = p * static_cast<float>(factor);
    // In the sensor's last codes the promise is good to a factor of two.
    EXPECT_LE(irradiance_error(after, r.exposures, 3), std::max(.01, 2 * r.promised)) << factor;
    if (factor > 1) {
      EXPECT_LE(*first, changed + before.exposures.size()) << "brighter: within one ring";
    }
  }
}

TEST(ExposureSchedule, StandsStillUnderAStillLight) {
  const Followed r =
      run(scaled(make_room_environment(kScheduleWidth, kScheduleHeight), 20), .01, 600);
  EXPECT_LE(r.changes.size(), 4u) << "the probe, what it found, and hardly more";
  for (const std::size_t n : r.changes) EXPECT_LT(n, 150u);
}

// As V4L2 gives them: times in steps of 100 us from nothing on, no gain.
class SteppedCamera : public test::FakeCamera {
 public:
  using FakeCamera::FakeCamera;
  Exposure nearest(Exposure wanted) const override {
    return {Seconds(1e-4 * std::round(wanted.time.count() / 1e-4)), Gain(1)};
  }
};

TEST(ExposureSchedule, AsksForWhatTheDeviceHas) {
  BracketedCamera camera(camera_info(), {}, 2, .01, kFps);
  ASSERT_TRUE(
      camera.connect(std::make_unique<SteppedCamera>(clear_sky(), test::FakeCameraBehaviour{})));
  for (int n = 0; n < 90; ++n) {
    const auto frame = camera.next(Seconds(.1));
    ASSERT_TRUE(frame);
    if (!*frame) continue;
    const auto& asked = camera.counts().exposures;
    ASSERT_FALSE(asked.empty());
    for (std::size_t k = 0; k < asked.size(); ++k) {
      const double steps = asked[k].time.count() / 1e-4;
      EXPECT_GT(steps, .5);
      EXPECT_NEAR(steps, std::round(steps), 1e-6);
      if (k > 0) {
        EXPECT_LT(asked[k].time, asked[k - 1].time);
      }
    }
  }
}

TEST(ExposureSchedule, BeyondTheSensorsLimitsItComesAsNearAsItCan) {
  const ExposureLimits narrow{Seconds(1. / 500), Seconds(1. / 30), Gain(1)};
  const ExposurePlanner planner(camera_info(), 8);
  const std::vector<RadianceBin> light = {{10, 10, 12, 1e5}, {1e5, 1e5, .001, 10}};
  const SchedulePlan plan = planner.plan(light, narrow, .01);
  EXPECT_GT(plan.error(), .01);
  ASSERT_FALSE(plan.exposures.empty());
  EXPECT_NEAR(plan.exposures.back().time.count(), 1. / 500, 1e-9) << "the shortest that there is";
  EXPECT_LE(plan.exposures.size(), 2u) << "more would hardly help";
}

TEST(ExposureSchedule, DarkSceneUsesGainOnceTimesAreSpent) {
  const ExposureLimits limits{Seconds(1e-4), Seconds(1. / 33), Gain(8)};
  const ExposurePlanner planner(camera_info(), 8);
  const SchedulePlan dim = planner.plan({{.02, .02, 12, 1e5}}, limits, .01);
  ASSERT_EQ(dim.exposures.size(), 1u);
  EXPECT_NEAR(dim.exposures[0].time.count(), 1. / 33, 1e-9);
  EXPECT_GT(dim.exposures[0].gain.value(), 1);
}

TEST(ExposureSchedule, BlackAndWhiteScenesAreNoError) {
  const ExposurePlanner planner(camera_info(), 8);
  for (const double radiance : {0., 1e9}) {
    const SchedulePlan plan = planner.plan({{radiance, radiance, 12, 1e5}}, {}, .01);
    EXPECT_FALSE(plan.exposures.empty());
    EXPECT_TRUE(std::isfinite(plan.error()));
  }
  EXPECT_FALSE(planner.plan({}, {}, .01).exposures.empty());
}

}  // namespace
}  // namespace penumbra::capture
