// After warm-up nothing is taken from the heap.
#include "calib/calib.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "runtime/governor/governor_config.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "tests/support/allocations.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <string>

#include "capture/capture.h"
#include "runtime/pipeline/light_file.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {
namespace {

struct Counted {
  std::size_t calls, bytes;
};
template <class Work>
Counted count(Work work) {
  const std::size_t calls = test::allocations, bytes = test::allocated_bytes;
  work();
  return {test::allocations - calls, test::allocated_bytes - bytes};
}

void expect_none(const Counted& c, const std::string& what) {
  EXPECT_EQ(c.calls, 0u) << what << ": " << c.bytes << " bytes";
}

PreparedScene scene_on(const Rgb& floor_albedo) {
  PreparedScene scene;
  scene.planes.push_back({{0, 0, 0}, {0, 1, 0}, floor_albedo, {}});
  prt::Mesh mesh = prt::make_knot(.5f, 160, 32, {.5f, .5f, .5f});
  prt::BakeOptions bake;
  bake.rays = bake.ground_rays = 64;
  bake.bounces = 1;
  bake.visibility = true;
  bake.receiver = prt::Receiver{prt::fit_ground_grid(mesh, 0, 32), {.4f, .4f, .4f}};
  scene.objects.push_back({"knot", *prt::bake(std::move(mesh), bake), {}, 0, nullptr});
  return scene;
}

// As from one map to the next under a head that turns: all sources are traced anew.
lighting::LightEstimate turned(lighting::LightEstimate light, std::size_t step) {
  const glm::dmat3 turn =
      glm::mat3_cast(glm::angleAxis(.04 * double(step % 7), glm::dvec3(0, 1, 0)));
  for (lighting::DistantLight& d : light.lights) {
    d.direction = turn * d.direction;
    for (glm::dvec3& s : d.shape) s = turn * s;
  }
  return light;
}

void expect_none_after_warm_up(Image<Rgb> environment, int knots = 1, int rows = 128) {
  // Each worker brings memory of its own when it first takes part, whenever that is.
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  auto world = *capture::FloorWorld::make(std::move(environment));
  PreparedScene scene = scene_on(world->mean_floor_albedo());
  for (int i = 1; i < knots; ++i) {
    PreparedObject& next = scene.objects.emplace_back(scene.objects[0]);
    next.world_from_bake.translation.x += 1.2 * i;
  }
  capture::StudioOptions options;
  options.environment_width = 2 * rows, options.environment_height = rows;
  options.view_width = 320, options.view_height = 180, options.view_focal_px = 240;
  options.world_from_view = capture::look_at({.2, .6, 1.4}, {0, .2, 0});
  options.sensor.response = calib::Response::srgb();
  options.view_frames = 80;
  capture::Studio studio(world, options);
  StageTimes times;
  auto light = *LightEstimationStage::create(studio.cameras(), {}, times);
  const auto governor_config = make_governor_config(scene, {.max_error = .02}, CostSource::kFixed);
  ASSERT_TRUE(governor_config);
  light.set_governor(*governor_config);
  auto compose = CompositeStage::create(studio.cameras(), scene,
                                        compositor::Compositor::Surface::kOffscreen, times);
  if (!compose && compose.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << compose.error().detail;
  constexpr std::size_t kWarm = 90;
  lighting::LightEstimate estimate;
  Composited composited;
  std::size_t seen = 0, moved = 0, traced = 0;
  while (auto frame = *studio.next()) {
    ++seen;
    if (light.takes(frame->camera)) {
      const Counted c = count([&] { ASSERT_TRUE(light.process(*frame, estimate)); });
      if (seen > kWarm) expect_none(c, "light " + std::to_string(seen));
      continue;
    }
    const Counted c =
        count([&] { ASSERT_TRUE((*compose)->process(*frame, estimate, composited)); });
    if (seen > kWarm) expect_none(c, "frame " + std::to_string(seen));
    const lighting::LightEstimate other = turned(estimate, ++moved);
    const Counted m = count([&] { traced += (*compose)->shade(other, 0); });
    if (seen > kWarm) expect_none(m, "turned light " + std::to_string(seen));
  }
  EXPECT_GT(seen, kWarm + 20);
  EXPECT_GT(traced, moved / 2);
  EXPECT_FALSE(estimate.lights.empty());
}

TEST(Allocations, OfALightUpdateAndAFrameInARoom) {
  if (!test::kCountsAllocations) GTEST_SKIP() << "a sanitizer counts them in its own way";
  expect_none_after_warm_up(capture::make_room_environment(256, 128));
}

TEST(Allocations, OfALightUpdateAndAFrameUnderASun) {
  if (!test::kCountsAllocations) GTEST_SKIP() << "a sanitizer counts them in its own way";
  expect_none_after_warm_up(capture::make_sky_environment(256, 128, .7));
}

// Read in blocks of pixels.
TEST(Allocations, OfALargerMapUnderAnEvenSky) {
  if (!test::kCountsAllocations) GTEST_SKIP() << "a sanitizer counts them in its own way";
  expect_none_after_warm_up(capture::make_room_environment(512, 256), 1, 256);
}

// Each is in the other's light.
TEST(Allocations, OfTwoObjectsBesideEachOther) {
  if (!test::kCountsAllocations) GTEST_SKIP() << "a sanitizer counts them in its own way";
  expect_none_after_warm_up(capture::make_sky_environment(256, 128, .7), 2);
}

}  // namespace
}  // namespace penumbra::runtime
