// A sun that no exposure holds, from the sensor to the light: flagged and completed.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "calib/calib.h"
#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "tests/support/reflectance_patch.h"

namespace penumbra::lighting {
namespace {

using glm::dvec3;

constexpr int kClippedWidth = 512, kClippedHeight = 256;
const dvec3 kUp(0, 1, 0);

// What a camera makes of the map; the shortest exposure is clipped from a radiance of 9.5 on.
Environment capture_map(const Image<Rgb>& map, std::uint64_t seed) {
  capture::CameraInfo camera;
  camera.name = "environment";
  camera.projection =
      *calib::make_projection(calib::ProjectionKind::kLatLong, kClippedWidth, kClippedHeight);
  capture::HdrRing ring(camera, 2);
  const capture::MergedImage* merged = nullptr;
  for (const double seconds : {.4, .1}) {
    auto pixels = std::make_shared<FramePixels>();
    const Exposure exposure{Seconds(seconds), Gain(1)};
    capture::expose({}, map, exposure, seed + (seconds < .2), *pixels);
    const auto added = ring.add({0, seed, {0}, exposure, {}, pixels});
    EXPECT_TRUE(added);
    if (added) merged = *added;
  }
  Environment out;
  capture::EnvironmentAssembler(camera.projection, {}, kClippedWidth, kClippedHeight)
      .assemble(*merged, out);
  return out;
}

// The map's energy above what the sky has around the sun.
Rgb sun_power(const Image<Rgb>& map) {
  double sum[3] = {};
  for (int y = 0; y < map.height(); ++y)
    for (const Rgb& v : map.row(y))
      for (int c = 0; c < 3; ++c)
        if (v.g > 9) sum[c] += latlong_solid_angle(y, map.width(), map.height()) * double(v[c] - 1);
  return {float(sum[0]), float(sum[1]), float(sum[2])};
}

Rgb irradiance_of(const Image<Rgb>& map, const dvec3& normal, float largest) {
  double sum[3] = {};
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x) {
      const dvec3 d = latlong_direction(x + .5, y + .5, map.width(), map.height());
      const double w =
          latlong_solid_angle(y, map.width(), map.height()) * std::max(0., glm::dot(normal, d));
      for (int c = 0; c < 3; ++c) sum[c] += w * double(std::min(map.at(x, y)[c], largest));
    }
  return {float(sum[0]), float(sum[1]), float(sum[2])};
}

Rgb power(const DistantLight& d) {
  return d.radiance * static_cast<float>(d.solid_angle_sr());
}

// A frame of dark wood over everything east of the middle of the sun.
Image<Rgb> behind_frame(Image<Rgb> map) {
  int brightest_x = 0;
  float peak = 0;
  for (int y = 0; y < map.height(); ++y)
    for (int x = 0; x < map.width(); ++x)
      if (map.at(x, y).g > peak) peak = map.at(x, y).g, brightest_x = x;
  for (int y = 0; y < map.height() / 2; ++y)
    for (int x = brightest_x + 1; x < brightest_x + 25; ++x)
      map.at(x % map.width(), y) = {.1f, .07f, .05f};
  return map;
}

struct Scene {
  const char* name;
  bool frame;
  double elevation_rad;
};

void PrintTo(const Scene& s, std::ostream* out) {
  *out << s.name;
}

class ClippedSun : public testing::TestWithParam<Scene> {
 protected:
  void SetUp() override {
    map_ = capture::make_sky_environment(kClippedWidth, kClippedHeight, GetParam().elevation_rad);
    if (GetParam().frame) map_ = behind_frame(map_);
    truth_ = sun_power(map_);
    environment_ = capture_map(map_, 11);
    const auto light = estimator_.estimate(environment_);
    ASSERT_TRUE(light);
    light_ = *light;
  }
  void expect_true_sun(const Rgb& got) const {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(got[c] / truth_[c], 1, .05) << c;
  }
  // Half a percent of noise, as the mean of some hundred pixels has.
  Rgb seen(const dvec3& normal, const Rgb& albedo, float largest) {
    std::normal_distribution<float> noise(1, .005f);
    Rgb out = irradiance_of(map_, normal, largest) * albedo * static_cast<float>(1 / kPi);
    for (int c = 0; c < 3; ++c) out[c] *= noise(rng_);
    return out;
  }

  std::mt19937 rng_{1};
  Image<Rgb> map_;
  Rgb truth_;
  Environment environment_;
  LightEstimator estimator_{EstimateOptions{}};
  LightEstimate light_;
};

TEST_P(ClippedSun, IsLostWithoutAFlagAndFlaggedWithIt) {
  Environment silent = environment_;
  silent.clipped.clear();
  const auto naive = LightEstimator({}).estimate(silent);
  ASSERT_TRUE(naive);
  Rgb kept;
  for (const DistantLight& d : naive->lights) {
    kept += power(d);
    EXPECT_FALSE(d.clipped);
  }
  EXPECT_LT(luminance(kept), .2 * luminance(truth_));
  EXPECT_LT(luminance(irradiance_of(environment_.radiance, kUp, 1e9f)),
            .8 * luminance(irradiance_of(map_, kUp, 1e9f)));

  ASSERT_EQ(std::ranges::count_if(light_.lights, &DistantLight::clipped), 1);
  RecordProperty("kept", std::to_string(luminance(kept) / luminance(truth_)));
}

TEST_P(ClippedSun, AGreyPatchGivesItsEnergyBack) {
  const Rgb grey{.18f, .18f, .18f};
  const dvec3 tilted = glm::normalize(dvec3(.4, .5, -.7));
  for (int trial = 0; trial < 10; ++trial) {
    const dvec3& normal = trial % 2 ? kUp : tilted;
    const auto got = test::recover_from_patch(light_, {normal, seen(normal, grey, 1e9f), grey});
    ASSERT_TRUE(got) << got.error().detail;
    expect_true_sun(got->front().power);
    ASSERT_TRUE(estimator_.add_recovery(got->front()));
    environment_.time = environment_.time + Seconds(.033);
    const auto later = estimator_.estimate(environment_);
    ASSERT_TRUE(later);
    const auto sun = std::ranges::find_if(later->lights, &DistantLight::clipped);
    ASSERT_NE(sun, later->lights.end());
    EXPECT_EQ(sun->radius, kSunRadius);
    expect_true_sun(power(*sun));
  }
}

TEST_P(ClippedSun, AShadowEdgeGivesItsEnergyBack) {
  const Rgb floor{.4f, .31f, .22f};
  const auto sun = std::ranges::find_if(light_.lights, &DistantLight::clipped);
  ASSERT_NE(sun, light_.lights.end());
  for (int trial = 0; trial < 10; ++trial) {
    const ShadowRegion regions[] = {{seen(kUp, floor, 1e9f)},
                                    {seen(kUp, floor, 2.f), {1, 1, 1}, {}, {{sun->id, {}}}}};
    const auto got = recover_from_shadows(light_, {kUp, regions});
    ASSERT_TRUE(got) << got.error().detail;
    expect_true_sun(got->powers[0].power);
  }
}

INSTANTIATE_TEST_SUITE_P(Skies, ClippedSun,
                         testing::Values(Scene{"high_sun", false, 1.}, Scene{"low_sun", false, .5},
                                         Scene{"behind_a_frame", true, .8}),
                         [](const auto& i) { return std::string(i.param.name); });

}  // namespace
}  // namespace penumbra::lighting
