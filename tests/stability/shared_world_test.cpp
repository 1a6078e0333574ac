// What shares a place with other things, virtual or real, through the whole compositor: each test
// also does the naive thing and shows that it fails.
#include <gtest/gtest.h>

#include <cmath>

#include "capture/capture.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "tests/support/mesh_files.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"

namespace penumbra::runtime {

using namespace tools;
namespace {

using glm::dvec3;
using test::prepared, test::twist, test::grey_plane;

const prt::PinholeView kView{
    160, 120, {150, 150}, {80, 60}, capture::look_at({.5, 1.2, 1.5}, {0, .15, 0})};

RealGeometry real_box(const std::filesystem::path& folder, const glm::vec3& low,
                      const glm::vec3& high) {
  test::write_obj(prt::make_box(low, high, 8, {.4f, .4f, .4f}), folder / "box.obj");
  RealGeometry g;
  g.mesh = (folder / "box.obj").string();
  g.albedo = Rgb{.4f, .4f, .4f};
  return g;
}

Still grey_picture() {
  Still real;
  real.radiance = Image<Rgb>(kView.width, kView.height, {.5f, .5f, .5f});
  return real;
}

std::optional<Image<Rgb>> composited(const PreparedScene& scene,
                                     const lighting::LightEstimate& light) {
  auto pipeline = make_still_pipeline(scene, kView, {});
  if (!pipeline) {
    EXPECT_EQ(pipeline.error().code, ErrorCode::kUnavailable) << pipeline.error().detail;
    return std::nullopt;
  }
  auto still = composite_still(*pipeline, kView, light, grey_picture());
  EXPECT_TRUE(still) << still.error().detail;
  return still ? std::optional(std::move(still->radiance)) : std::nullopt;
}

double worst_difference(const Image<Rgb>& a, const Image<Rgb>& b) {
  double worst = 0;
  for (std::size_t i = 0; i < a.area(); ++i)
    worst = std::max(worst, double(std::abs(luminance(a.pixels()[i]) - luminance(b.pixels()[i]))) /
                                std::max(.5f, luminance(b.pixels()[i])));
  return worst;
}

class Coincident : public testing::TestWithParam<bool> {};

TEST_P(Coincident, TwoEqualObjectsInOnePlaceLookLikeOne) {
  const test::TempFolder folder;
  Scene one{{twist({0, 0, 0})}, {grey_plane()}};
  if (GetParam()) one.real.push_back(real_box(folder.path(), {.3f, 0, -.4f}, {.7f, .5f, .4f}));
  Scene two = one;
  two.objects.push_back(two.objects[0]);
  const auto single = prepared(one), twice = prepared(two);
  ASSERT_TRUE(single && twice);
  for (const double elevation : {.5, 1.2}) {
    const auto light =
        lighting::estimate_map(capture::make_sky_environment(256, 128, elevation), {});
    ASSERT_TRUE(light);
    const auto a = composited(*single, *light), b = composited(*twice, *light);
    if (!a || !b) GTEST_SKIP() << "no OpenGL ES 3.1 here";
    // Beside a box each sees the box past the other: of the rays some end on that.
    EXPECT_LT(worst_difference(*b, *a), GetParam() ? 3e-3 : 1e-3);
    // What a product of two shadows would be.
    Image<Rgb> product = *a;
    for (Rgb& c : product.pixels()) c = c * std::min(1.f, luminance(c) / .5f);
    EXPECT_GT(worst_difference(product, *a), .1);
  }
}

INSTANTIATE_TEST_SUITE_P(Stability, Coincident, testing::Bool(), [](const auto& test) {
  return std::string(test.param ? "BesideARealBox" : "OnAFloor");
});

double mean_luminance(const Still& still, const std::vector<bool>& where) {
  double sum = 0, count = 0;
  for (std::size_t i = 0; i < where.size(); ++i)
    if (where[i]) sum += double(luminance(still.radiance.pixels()[i])), ++count;
  return sum / count;
}

// RMS over the named pixels of what the picture misses of the truth, in a unit.
double rms_over(const Still& ours, const Still& truth, double unit,
                const std::vector<bool>& where) {
  double square = 0, count = 0;
  for (std::size_t i = 0; i < where.size(); ++i) {
    if (!where[i]) continue;
    const double d = luminance(ours.radiance.pixels()[i]) - luminance(truth.radiance.pixels()[i]);
    square += d * d / (unit * unit);
    ++count;
  }
  EXPECT_GT(count, 200) << "pixels to judge by";
  return std::sqrt(square / count);
}

constexpr double kReferenceError = .008;

// The world with the object in it, our composite, and the naive scene's in the same picture.
struct Judged {
  Still empty, truth, ours, naive;
};

std::optional<Judged> judge(const PreparedScene& scene, const PreparedScene& naive_scene,
                            const Image<Rgb>& map) {
  const StillScene in{&scene, &map, kView};
  auto empty = render_real(in, kReferenceError, {}),
       truth = render_reference(in, true, kReferenceError, std::nullopt, {});
  const auto light = lighting::estimate_map(map, {});
  if (!empty || !truth || !light) return std::nullopt;
  auto ours = render_composite(in, *light, *empty),
       naive = render_composite({&naive_scene, &map, kView}, *light, *empty);
  if (!ours || !naive) return std::nullopt;
  return Judged{std::move(*empty), std::move(*truth), std::move(*ours), std::move(*naive)};
}

dvec3 towards_sun(const Image<Rgb>& map) {
  const auto brightest =
      std::ranges::max_element(map.pixels(), {}, [](const Rgb& c) { return luminance(c); });
  const auto i = static_cast<int>(brightest - map.pixels().begin());
  return latlong_direction(i % map.width() + .5, i / map.width() + .5, map.width(), map.height());
}

TEST(VirtualShadow, OverARealOneTakesOnlyWhatLightIsLeft) {
  const test::TempFolder folder;
  const Image<Rgb> map = capture::make_sky_environment(512, 256, .5);
  // A real wall stands before the sun: the virtual object and its shadow lie in the wall's own.
  const dvec3 sun = towards_sun(map), away = glm::normalize(dvec3(sun.x, 0, sun.z)) * .45;
  const glm::vec3 low(away - dvec3(.35, 0, .35)), high(away + dvec3(.35, .9, .35));
  const Scene with_wall{{twist({0, 0, 0})}, {grey_plane(), real_box(folder.path(), low, high)}},
      without{{twist({0, 0, 0})}, {grey_plane()}};
  const auto scene = prepared(with_wall), naive_scene = prepared(without);
  ASSERT_TRUE(scene && naive_scene);
  const auto masks = make_masks(*scene, kView);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks) << masks.error().detail;
  const auto seen = judge(*scene, *naive_scene, map);
  ASSERT_TRUE(seen);
  const float open =
      luminance(scene->planes[0].albedo * exact_irradiance(map, {0, 1, 0})) / float(kPi);
  std::vector<bool> dark = masks->floor;
  for (std::size_t i = 0; i < dark.size(); ++i)
    if (luminance(seen->empty.radiance.pixels()[i]) > .6f * open) dark[i] = false;
  const double shadow = rms_over(seen->ours, seen->truth, open, dark),
               naive_shadow = rms_over(seen->naive, seen->truth, open, dark);
  std::printf("virtual shadow in a real one: off by %.4f in s, as if no wall stood there %.3f\n",
              shadow, naive_shadow);
  EXPECT_LT(shadow, .03);
  EXPECT_GT(naive_shadow, .06) << "the sun taken twice";
  // The object itself: in the wall's shadow, not in the sun.
  const double mean = mean_luminance(seen->truth, masks->object),
               ours = rms_over(seen->ours, seen->truth, mean, masks->object),
               naive = rms_over(seen->naive, seen->truth, mean, masks->object);
  std::printf(
      "object in a real shadow: off by %.1f %%, as if the wall let the sun through %.0f %%\n",
      100 * ours, 100 * naive);
  EXPECT_LT(ours, .12);
  EXPECT_GT(naive, .3) << "no wall before the sun";
}

TEST(RealPlane, SeenFromBehindHidesNothing) {
  const RealGeometry between = grey_plane({0, 0, .7}, {0, 0, -1});  // camera and object, facing it
  const auto alone = prepared({{twist({0, 0, 0})}, {grey_plane()}}),
             behind = prepared({{twist({0, 0, 0})}, {grey_plane(), between}});
  ASSERT_TRUE(alone && behind);
  const auto a = make_masks(*alone, kView), b = make_masks(*behind, kView);
  if (!a && a.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << a.error().detail;
  ASSERT_TRUE(a && b);
  EXPECT_EQ(std::ranges::count(a->object, true), std::ranges::count(b->object, true));
}

TEST(TiltedObject, CastsTheShadowOfHowItLies) {
  const test::TempFolder folder;
  test::write_obj(prt::make_box({-.08f, 0, -.12f}, {.08f, .6f, .12f}, 12, {.6f, .6f, .6f}),
                  folder.path() / "post.obj");
  SceneObject upright;
  upright.asset = (folder.path() / "post.obj").string();
  upright.name = "post";
  upright.scale = 1;
  SceneObject lying = upright;
  lying.rotation = glm::angleAxis(kPi / 2, dvec3(0, 0, 1));
  lying.position = {.3, .08, 0};
  const auto scene = prepared({{lying}, {grey_plane()}}),
             naive_scene = prepared({{upright}, {grey_plane()}});
  ASSERT_TRUE(scene && naive_scene);
  const auto masks = make_masks(*scene, kView), naive_masks = make_masks(*naive_scene, kView);
  if (!masks && masks.error().code == ErrorCode::kUnavailable)
    GTEST_SKIP() << "no OpenGL ES 3.1 here: " << masks.error().detail;
  ASSERT_TRUE(masks && naive_masks);
  std::vector<bool> both = masks->floor;
  for (std::size_t i = 0; i < both.size(); ++i) both[i] = both[i] && naive_masks->floor[i];
  for (const Image<Rgb>& map :
       {capture::make_room_environment(512, 256), capture::make_sky_environment(512, 256, .8)}) {
    const auto seen = judge(*scene, *naive_scene, map);
    ASSERT_TRUE(seen);
    const float open = luminance(seen->empty.radiance.at(4, kView.height - 4));
    std::vector<bool> shaded = both;
    for (std::size_t i = 0; i < both.size(); ++i)
      if (luminance(seen->truth.radiance.pixels()[i]) > .95f * open) shaded[i] = false;
    EXPECT_LT(rms_over(seen->ours, seen->truth, open, shaded), .03);
    EXPECT_GT(rms_over(seen->naive, seen->truth, open, shaded), .05)
        << "the shadow of an upright one";
  }
}

}  // namespace
}  // namespace penumbra::runtime
