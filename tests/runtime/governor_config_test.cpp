// What the governor is told of a scene, and what it keeps between starts.
#include "runtime/governor/governor_config.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "core/io/files.h"
#include "lighting/lighting.h"
#include "runtime/governor/internal/kept_costs.h"
#include "runtime/governor/single_thread_time.h"
#include "runtime/scene/bake_cache.h"
#include "runtime/scene/scene.h"
#include "tests/support/temp_folder.h"

namespace penumbra::runtime {
namespace {

PreparedScene box_scene(const glm::dquat& rotation = {1, 0, 0, 0}) {
  SceneObject box;
  box.asset = "builtin:box";
  box.name = "box";
  box.place_on_floor = true;
  box.rotation = rotation;
  RealGeometry floor;
  floor.plane = RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  BakeSettings settings;
  settings.rays = settings.ground_rays = 64;
  settings.cache = runtime::BakeCache::kNotUsed;
  auto scene =
      prepare({{box}, {floor}}, settings, [](const std::string&) { return [](double) {}; });
  EXPECT_TRUE(scene);
  return std::move(*scene);
}

class KeptCosts : public testing::Test {
 protected:
  void SetUp() override { ::setenv("XDG_CACHE_HOME", folder_.path().c_str(), 1); }
  void TearDown() override { ::unsetenv("XDG_CACHE_HOME"); }
  std::filesystem::path file() const {
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path() / "penumbra"))
      return entry.path();
    return {};
  }
  // How often `recall` had to fit.
  int fits_of(double fine_light_ms, lighting::CostModel& out) {
    int fits = 0;
    const auto costs = recall_or_fit(scene_, [&]() -> Result<lighting::CostModel> {
      ++fits;
      return lighting::CostModel{.fine_light_ms = fine_light_ms};
    });
    EXPECT_TRUE(costs);
    if (costs) out = *costs;
    return fits;
  }
  test::TempFolder folder_;
  PreparedScene scene_ = box_scene();
};

TEST_F(KeptCosts, AreFittedOnceAndRecalled) {
  lighting::CostModel costs;
  EXPECT_EQ(fits_of(7.25, costs), 1);
  EXPECT_EQ(fits_of(9, costs), 0);
  EXPECT_DOUBLE_EQ(costs.fine_light_ms, 7.25);
  EXPECT_DOUBLE_EQ(costs.read_ms, lighting::CostModel{}.read_ms);
}

TEST_F(KeptCosts, OfAnotherSceneAreItsOwn) {
  lighting::CostModel costs;
  fits_of(7.25, costs);
  scene_.objects.push_back(scene_.objects[0]);
  EXPECT_EQ(fits_of(9, costs), 1);
}

TEST_F(KeptCosts, DamagedOnesAreFittedAnew) {
  lighting::CostModel costs;
  ASSERT_EQ(fits_of(7.25, costs), 1);
  for (const char* text :
       {"", "{", "[1, 2]", "{\"fine_light_ms\": 1}", "{\"fine_light_ms\": \"x\"}"}) {
    ASSERT_TRUE(write_bytes(file(), text));
    EXPECT_EQ(fits_of(3, costs), 1) << text;
    EXPECT_EQ(fits_of(4, costs), 0) << text;
  }
  auto text = read_text(file());
  ASSERT_TRUE(text);
  text->replace(text->find("3.0"), 3, "-3.");
  ASSERT_TRUE(write_bytes(file(), *text));
  EXPECT_EQ(fits_of(3, costs), 1) << "a negative time";
}

TEST_F(KeptCosts, TheProcessorIsKnown) {
  EXPECT_FALSE(processor_name().empty());
}

// A large scene must not hold up the start: fewer runs, one at least.
TEST(FittedCosts, TakeFewerRunsOfWhatIsSlow) {
  const auto runs_of = [](double run_ms, double max_ms) {
    int runs = 0;
    const LightTime time = time_single_threaded(
        5,
        [&](int) {
          std::this_thread::sleep_for(std::chrono::duration<double, std::milli>(run_ms));
          ++runs;
        },
        max_ms);
    EXPECT_GE(time.p50_ms, run_ms);
    return runs;
  };
  EXPECT_EQ(runs_of(.1, 60'000), 5);
  EXPECT_LE(runs_of(30, 50), 2);
  EXPECT_EQ(runs_of(30, 1), 1);
}

TEST(FittedCosts, ArePositiveAndFinite) {
  const PreparedScene scene = box_scene();
  const auto costs = fit_costs(scene);
  ASSERT_TRUE(costs);
  for (const double ms : {costs->relight_ms, costs->fine_light_ms, costs->coarse_light_ms,
                          costs->wide_light_ms, costs->read_ms, costs->read_blocks_ms}) {
    EXPECT_GT(ms, 0);
    EXPECT_LT(ms, 1000);
  }
}

TEST(SceneProbes, AreThoseOfTheSceneInTheWorldsFrame) {
  const PreparedScene straight = box_scene();
  const lighting::SceneProbes probes = scene_probes(straight, 5);
  EXPECT_GT(probes.floor_points(), 8u);
  EXPECT_EQ(probes.object_points(), 64u);
  EXPECT_EQ(probes.transfer_bands, 5);
  EXPECT_TRUE(probes.level && probes.on_planes_only && probes.has_floor);
  EXPECT_EQ(scene_probes(straight, 3).transfer_bands, 3);
  // Turned as it stands, it is lit from the other side. Naive: the bake's frame.
  PreparedScene turned = straight;
  turned.objects[0].world_from_bake.rotation =
      glm::angleAxis(kPi, glm::dvec3(0, 1, 0)) * turned.objects[0].world_from_bake.rotation;
  const lighting::SceneProbes other = scene_probes(turned, 5);
  for (std::size_t p = 0; p < other.object_points(); ++p) {
    const float *a = &probes.transfer[25 * p], *b = &other.transfer[25 * p];
    EXPECT_NEAR(a[0], b[0], 1e-4f);
    EXPECT_NEAR(a[1], b[1], 1e-3f) << "y, along the axis";
    EXPECT_NEAR(a[2], -b[2], 1e-3f) << "z";
    EXPECT_NEAR(a[3], -b[3], 1e-3f) << "x";
  }
}

TEST(SceneProbes, ASceneOfNothingTellsNothing) {
  const lighting::SceneProbes none = scene_probes({}, 5);
  EXPECT_EQ(none.floor_points() + none.object_points(), 0u);
  EXPECT_FALSE(none.has_floor || none.tell_of_bands());
}

// What stands on a real mesh has no bake of its shadow: a ball on a floor stands in for it, which
// takes h/d^3 of an even sky (radius and height 1, d from the place to its middle).
TEST(SceneProbes, ABallStandsInWhereNoBakeTellsOfTheShadow) {
  PreparedScene scene = box_scene();
  scene.objects[0].baked.shadow_probes = {};
  const lighting::SceneProbes probes = scene_probes(scene, 5);
  ASSERT_EQ(probes.floor_points(), 32u);
  for (std::size_t p = 0; p < probes.floor_points(); ++p) {
    const double away = .6 + 1.8 * (static_cast<double>(p) + .5) / 32,
                 taken = kPi / std::pow(1 + away * away, 1.5);
    EXPECT_NEAR(probes.deficit[kMaxCoefficients * p] * std::sqrt(4 * kPi), taken, .01 * taken) << p;
  }
  scene.planes.clear();
  EXPECT_EQ(scene_probes(scene, 5).floor_points(), 0u) << "nothing is below";
}

TEST(SceneProbes, WhatFloatsNeedsAllDirections) {
  PreparedScene scene = box_scene();
  scene.objects[0].baked.receiver.reset();
  const lighting::SceneProbes probes = scene_probes(scene, 5);
  EXPECT_TRUE(probes.level);
  EXPECT_FALSE(probes.tell_of_bands());
}

TEST(SceneProbes, ManyObjectsShareThePoints) {
  PreparedScene scene = box_scene();
  for (int i = 0; i < 9; ++i) scene.objects.push_back(scene.objects[0]);
  EXPECT_LE(scene_probes(scene, 5).object_points(), 256u);
  EXPECT_GE(scene_probes(scene, 5).object_points(), 200u);
}

}  // namespace
}  // namespace penumbra::runtime
