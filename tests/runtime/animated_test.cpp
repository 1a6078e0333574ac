// Characters in scenes: against the path tracer, through files, and with everything else that a
// scene has.
#include "runtime/scene/animated.h"
#include "capture/capture.h"
#include "lighting/lighting.h"
#include "prt/prt.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <fstream>

#include "runtime/pipeline/light_file.h"
#include "runtime/pipeline/stage_access.h"
#include "runtime/scene/internal/standing.h"
#include "runtime/shading/composite_stage.h"
#include "tests/stability/maps.h"
#include "tests/support/gltf_files.h"
#include "tests/support/shared_data.h"
#include "tests/support/temp_folder.h"
#include "tests/support/worlds.h"
#include "tools/chart/measures/accuracy.h"
#include "tools/pictures/still.h"

namespace penumbra::runtime {

using namespace tools;
namespace {

using testing::HasSubstr;

Scene walker_scene(std::array<int, 2> light_map = {0, 0}) {
  Scene scene;
  SceneObject walker;
  walker.name = "walker";
  walker.asset = "builtin:walker";
  walker.animation = "Walk";
  walker.albedo = {.6f, .5f, .4f};
  walker.light_map = light_map;
  scene.objects.push_back(walker);
  RealGeometry floor;
  floor.plane = RealPlane{};
  floor.albedo = Rgb{.4f, .4f, .4f};
  scene.real.push_back(floor);
  return scene;
}

// The walk in few frames of few rays, for tests that are not about its light.
struct CoarseWalk {
  std::string file;
  float half_extent = 0;  // of its receiver, metres
};
CoarseWalk coarse_walk(const test::TempFolder& folder, const Rgb& albedo) {
  auto standing = standing_character("builtin:walker", albedo, "Walk", 0, 0);
  EXPECT_TRUE(standing);
  prt::SequenceOptions options;
  options.frames_per_second = 6;
  options.interpolation_error = 0;
  options.bands = 3;
  options.rays = options.ground_rays = 64;
  options.ground_size = 32;
  const std::filesystem::path journals[] = {folder.path() / "journal"};
  EXPECT_TRUE(prt::bake_frames(standing->character, standing->clip, options, {}, journals[0]));
  const auto sequence =
      prt::compress_frames(standing->character, standing->clip, options, journals);
  EXPECT_TRUE(sequence);
  const auto file = folder.path() / "walk.shlm";
  EXPECT_TRUE(prt::write_sequence(file, standing->character, standing->clip, *sequence));
  return {file, sequence->receiver->grid.half_extent};
}

Result<PreparedScene> prepare_quickly(const Scene& scene, int rays = 256) {
  return test::prepared(scene, rays);
}

prt::PinholeView view_of(int width, int height) {
  prt::PinholeView view{width, height, glm::dvec2(1.1 * height), {.5 * width, .5 * height}, {}};
  view.world_from_camera = capture::look_at({.9, 1.5, 2.6}, {0, .75, 0});
  return view;
}

// At moments of the walk under one light.
struct Figures {
  double object = 0, bias = 0, shadow = 0;
  int pictures = 0;
};
Figures compare_with_reference(const PreparedScene& scene, const Image<Rgb>& map, int moments,
                               double error) {
  Figures sum;
  const prt::PinholeView view = view_of(72, 120);
  const auto estimate = lighting::estimate_map(map, {});
  EXPECT_TRUE(estimate);
  for (int i = 0; i < moments; ++i) {
    const double t = 1.1 * (i + .37) / moments;  // between frames of the bake
    const StillScene in{&scene, &map, view, t};
    const auto masks = make_masks(scene, view, t);
    const auto real = render_real(in, error, {});
    EXPECT_TRUE(masks && real);
    const auto ours = render_composite(in, *estimate, *real);
    const auto truth = render_reference(in, true, error, {}, {});
    EXPECT_TRUE(ours && truth);
    const Accuracy a = compare_pictures(*ours, *truth, *real, *masks);
    sum.object += a.object_without_noise * a.object_without_noise;
    sum.bias += a.object_bias;
    sum.shadow += a.shadow_rmse * a.shadow_rmse;
    ++sum.pictures;
  }
  sum.object = std::sqrt(sum.object / sum.pictures);
  sum.shadow = std::sqrt(sum.shadow / sum.pictures);
  sum.bias /= sum.pictures;
  return sum;
}

TEST(AnimatedGroundTruth, TheWalkerIsLitAsIfItStoodThere) {
  const auto scene = prepare_quickly(walker_scene());
  ASSERT_TRUE(scene) << scene.error().detail;
  for (const auto& [name, map] : {std::pair{"room", capture::make_room_environment(512, 256)},
                                  {"sky", capture::make_sky_environment(512, 256, .8)}}) {
    const Figures f = compare_with_reference(*scene, map, 2, .02);
    std::printf("%s: object %.2f %%, bias %.2f %%, shadow %.4f\n", name, 100 * f.object,
                100 * f.bias, f.shadow);
    // Creases between limbs are narrower than the vertices stand apart: a light map shows them
    // better.
    EXPECT_LT(f.object, .04) << name;
    EXPECT_LT(std::abs(f.bias), .02) << name;
    EXPECT_LT(f.shadow, .05) << name;
  }
}

TEST(AnimatedGroundTruth, ALightMapIsAsGoodAsVertices) {
  const auto scene = prepare_quickly(walker_scene({96, 96}), 128);
  ASSERT_TRUE(scene) << scene.error().detail;
  ASSERT_GT(scene->objects[0].animation->layout.texels.size(), 3000u);
  for (const auto& map :
       {capture::make_room_environment(512, 256), capture::make_sky_environment(512, 256, .8)}) {
    const Figures f = compare_with_reference(*scene, map, 2, .02);
    std::printf("object %.2f %%, bias %.2f %%, shadow %.4f\n", 100 * f.object, 100 * f.bias,
                f.shadow);
    EXPECT_LT(f.object, .03);
    EXPECT_LT(std::abs(f.bias), .015);
  }
}

// Twenty moments under eight real environments take nine minutes: PENUMBRA_LONG=1 asks for them,
// another word for those whose names hold it, with a finer bake. Otherwise it is two under a veiled
// sun.
TEST(AnimatedGroundTruth, MomentsUnderRealEnvironments) {
  const char* const asked = std::getenv("PENUMBRA_LONG");
  const std::string only = asked ? asked : "immenstadter";
  const int moments = asked ? 20 : 2;
  PENUMBRA_NEED_SHARED(folder, "envmaps");
  const auto scene = asked ? prepare_quickly(walker_scene({128, 128}), 512)
                           : prepare_quickly(walker_scene({96, 96}), 128);
  ASSERT_TRUE(scene) << scene.error().detail;
  double square = 0;
  int count = 0;
  for (const auto& file : std::filesystem::directory_iterator(folder)) {
    if (!file.path().string().ends_with("_1k.hdr")) continue;
    if (only != "1" && file.path().string().find(only) == std::string::npos) continue;
    const auto light = read_light(file.path());
    ASSERT_TRUE(light);
    const auto map = whole_latlong(*light);
    const Figures f = compare_with_reference(*scene, *map, moments, .015);
    std::printf("%-44s object %.2f %%, bias %+.2f %%, shadow %.4f\n", file.path().stem().c_str(),
                100 * f.object, 100 * f.bias, f.shadow);
    std::fflush(stdout);
    // Edges of a sharp sun's shadow on the body are finer than texels and vertices.
    EXPECT_LT(f.object, .065) << file.path();
    square += f.object * f.object;
    ++count;
  }
  EXPECT_GT(count, 0);
  std::printf("all: object %.2f %%\n", 100 * std::sqrt(square / count));
  EXPECT_LT(std::sqrt(square / count), .03);
}

// What is left is as it was, `from_s` earlier: keys before 0 still lead to those after it.
void cut(prt::Clip& clip, double from_s, double length_s) {
  const auto earlier = [&](auto& track) {
    for (auto& key : track) key.seconds -= from_s;
  };
  for (prt::Clip::NodeTracks& t : clip.nodes)
    earlier(t.translation), earlier(t.scale), earlier(t.rotation);
  for (prt::Clip::MorphTrack& t : clip.morphs) earlier(t.weight);
  clip.seconds = length_s;
}

// The same clip baked for every picture, with more rays, and kept whole.
PreparedScene baked_finely(const PreparedScene& scene, double from_s, double length_s) {
  PreparedScene out = scene;
  PreparedObject& o = out.objects[0];
  auto fine = std::make_shared<Animation>(*o.animation);
  cut(fine->character.clips[static_cast<std::size_t>(fine->clip)], from_s, length_s);
  prt::SequenceOptions options;
  options.frames_per_second = 60;
  options.bands = 5;
  options.rays = options.ground_rays = 512;
  options.ground_size = o.baked.receiver->grid.size;
  options.ground_albedo = o.baked.receiver->albedo;
  options.error = 1e-4;
  // What is cut out jumps where it begins anew, and nobody looks there.
  options.interpolation_error = 0;
  const test::TempFolder folder;
  const std::filesystem::path journals[] = {folder.path() / "journal"};
  EXPECT_TRUE(prt::bake_frames(fine->character, fine->clip, options, {}, journals[0]));
  auto sequence = prt::compress_frames(fine->character, fine->clip, options, journals);
  EXPECT_TRUE(sequence);
  fine->sequence = std::move(*sequence);
  o.baked.receiver = fine->sequence.receiver;
  o.animation = fine;
  return out;
}

// F = RMS[(a_t - a_t-1) - (r_t - r_t-1)] / mean r on body and floor, sixty pictures a second.
TEST(AnimatedGroundTruth, AWalkDoesNotFlickerUnderAStandingLight) {
  const auto prepared = prepare_quickly(walker_scene());
  ASSERT_TRUE(prepared);
  constexpr int kPictures = 9;
  constexpr double kFrom_s = .3, kFirst_s = .01, kLength_s = .17;
  static_assert(kFirst_s + (kPictures - 1) / 60. < kLength_s - 1 / 60.,
                "the last baked frame blends into the first one");
  const PreparedScene truth = baked_finely(*prepared, kFrom_s, kLength_s);
  const prt::PinholeView view = view_of(160, 214);
  for (const auto& map :
       {capture::make_room_environment(512, 256), capture::make_sky_environment(512, 256, .8)}) {
    const auto estimate = lighting::estimate_map(map, {});
    ASSERT_TRUE(estimate);
    const auto real = render_real({&*prepared, &map, view, 0}, .05, {});
    ASSERT_TRUE(real);
    double flicker = 0, mean = 0, count = 0;
    Image<Rgb> before[2];
    for (int f = 0; f < kPictures; ++f) {
      const double t = kFrom_s + kFirst_s + f / 60.;
      const auto ours = render_composite({&*prepared, &map, view, t}, *estimate, *real),
                 should = render_composite({&truth, &map, view, t - kFrom_s}, *estimate, *real);
      const auto masks = make_masks(*prepared, view, t);
      ASSERT_TRUE(ours && should && masks);
      for (std::size_t i = 0; f > 0 && i < masks->floor.size(); ++i) {
        if (!masks->floor[i] && !masks->object[i]) continue;
        const auto change = [&](const Image<Rgb>& now, const Image<Rgb>& past) {
          return double(luminance(now.pixels()[i])) - double(luminance(past.pixels()[i]));
        };
        const double error =
            change(ours->radiance, before[0]) - change(should->radiance, before[1]);
        flicker += error * error;
        mean += luminance(should->radiance.pixels()[i]);
        ++count;
      }
      before[0] = ours->radiance;
      before[1] = should->radiance;
    }
    flicker = std::sqrt(flicker / count) / (mean / count);
    std::printf("flicker %.3f %%\n", 100 * flicker);
    EXPECT_LT(flicker, .005);
  }
}

TEST(Animated, StaticLightDoesNotFlickerOnAThingThatRests) {
  Scene scene = walker_scene();
  scene.objects[0].live = true;  // its own bake would be for nothing
  auto prepared = prepare_quickly(scene, 64);
  ASSERT_TRUE(prepared);
  // A clip that goes on but moves nothing: every frame is made anew and comes out the same.
  PreparedObject& walker = prepared->objects[0];
  auto resting = std::make_shared<Animation>(*walker.animation);
  resting->live = false;
  prt::Clip& clip = resting->character.clips[0];
  for (prt::Clip::NodeTracks& t : clip.nodes)
    t.rotation.resize(1), t.translation.resize(std::min<std::size_t>(t.translation.size(), 1));
  prt::SequenceOptions options;
  options.frames_per_second = 4;
  options.bands = 5;
  options.rays = options.ground_rays = 64;
  options.ground_size = 32;
  const test::TempFolder folder;
  const std::filesystem::path journals[] = {folder.path() / "j"};
  ASSERT_TRUE(prt::bake_frames(resting->character, 0, options, {}, journals[0]));
  auto sequence = prt::compress_frames(resting->character, 0, options, journals);
  ASSERT_TRUE(sequence);
  ASSERT_GT(sequence->surface.frames(), 3);
  resting->sequence = std::move(*sequence);
  walker.baked.receiver = resting->sequence.receiver;
  walker.animation = resting;
  walker.frame = -1;
  walker.move_to(0, {});
  const prt::PinholeView view = view_of(64, 96);
  const auto estimate = lighting::estimate_map(capture::make_room_environment(256, 128), {});
  auto pipeline = make_still_pipeline(*prepared, view, {});
  ASSERT_TRUE(pipeline);
  const Still backdrop{Image<Rgb>(64, 96, {.5f, .5f, .5f}), 0, 0, {}, {}};
  const auto first = composite_still(*pipeline, view, *estimate, backdrop, 0);
  const auto later = composite_still(*pipeline, view, *estimate, backdrop, 12.34);
  ASSERT_TRUE(first && later);
  EXPECT_EQ(std::memcmp(first->radiance.pixels().data(), later->radiance.pixels().data(),
                        first->radiance.area() * sizeof(Rgb)),
            0);
  const auto drawn = std::ranges::count_if(
      first->radiance.pixels(), [](const Rgb& p) { return std::abs(luminance(p) - .5f) > .01f; });
  EXPECT_GT(drawn, 300);
}

TEST(Animated, AWalkBesideOtherThingsIsDrawnWhole) {
  // A second object and a real box: shadows that meet, sides that see each other.
  const test::TempFolder folder;
  Scene scene = walker_scene();
  scene.objects[0].transfer = coarse_walk(folder, scene.objects[0].albedo).file;
  SceneObject box;
  box.name = "box";
  box.asset = "builtin:box";
  box.position = {.5, 0, .2};
  scene.objects.push_back(box);
  RealGeometry crate;
  crate.mesh = "builtin:box";
  crate.position = {-.6, 0, 0};
  scene.real.push_back(crate);
  const auto prepared = prepare_quickly(scene);
  ASSERT_TRUE(prepared) << prepared.error().detail;
  const prt::PinholeView view = view_of(80, 120);
  const auto estimate = lighting::estimate_map(capture::make_room_environment(256, 128), {});
  auto pipeline = make_still_pipeline(*prepared, view, {});
  ASSERT_TRUE(pipeline);
  const Still backdrop{Image<Rgb>(80, 120, {.5f, .5f, .5f}), 0, 0, {}, {}};
  std::optional<Image<Rgb>> before;
  for (const double t : {0., .2, .4}) {
    const auto still = composite_still(*pipeline, view, *estimate, backdrop, t);
    ASSERT_TRUE(still);
    for (const Rgb& c : still->radiance.pixels()) EXPECT_TRUE(is_finite(c));
    if (before) {
      double change = 0;
      for (std::size_t i = 0; i < before->area(); ++i)
        change += std::abs(luminance(before->pixels()[i]) - luminance(still->radiance.pixels()[i]));
      EXPECT_GT(change, 1);
    }
    before = still->radiance;
  }
}

// A walk in a room, drawn by pipelines of its own.
class DrawnWalk : public testing::Test {
 protected:
  void SetUp() override {
    Scene scene = walker_scene();
    scene.objects[0].transfer = coarse_walk(folder_, scene.objects[0].albedo).file;
    auto ready = prepare_quickly(scene);
    ASSERT_TRUE(ready) << ready.error().detail;
    prepared_ = std::move(*ready);
  }
  Result<Pipeline> pipeline() const { return make_still_pipeline(prepared_, view_, {}); }
  Image<Rgb> draw(Pipeline& p, double t) const {
    return composite_still(p, view_, *estimate_, backdrop_, t)->radiance;
  }
  const std::string& name() const { return prepared_.objects[0].name; }
  // Mean difference of luminance.
  static double apart(const Image<Rgb>& a, const Image<Rgb>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.area(); ++i)
      sum += std::abs(luminance(a.pixels()[i]) - luminance(b.pixels()[i]));
    return sum / static_cast<double>(a.area());
  }
  static bool same(const Image<Rgb>& a, const Image<Rgb>& b) {
    return std::ranges::equal(a.pixels(), b.pixels());
  }

  test::TempFolder folder_;
  PreparedScene prepared_;
  prt::PinholeView view_ = view_of(80, 120);
  Result<lighting::LightEstimate> estimate_ =
      lighting::estimate_map(capture::make_room_environment(256, 128), {});
  Still backdrop_{Image<Rgb>(80, 120, {.5f, .5f, .5f}), 0, 0, {}, {}};
};

// Taken away it is neither drawn nor moved, which would have all lights traced anew; shown again it
// is where its clip is by then.
TEST_F(DrawnWalk, TakenAwayItRestsAndShownAgainItHasGoneOn) {
  auto hidden = pipeline(), never_hidden = pipeline();
  ASSERT_TRUE(hidden && never_hidden);
  EXPECT_FALSE(same(draw(*hidden, 0), backdrop_.radiance)) << "it is seen";
  ASSERT_TRUE(hidden->show_object(name(), false));
  EXPECT_TRUE(same(draw(*hidden, .2), backdrop_.radiance));
  EXPECT_FALSE(StageAccess::stage_of(*hidden).shade(*estimate_, .3))
      << "nothing moves: nothing is shaded";
  ASSERT_TRUE(hidden->show_object(name(), true));
  draw(*never_hidden, 0);
  const Image<Rgb> back = draw(*hidden, .4);
  EXPECT_LT(apart(back, draw(*never_hidden, .4)), 1e-4);
}

// Held it is drawn the same at any time; told another time it is drawn as one that came there.
TEST_F(DrawnWalk, IsHeldAndSetToAnotherTimeByACall) {
  auto played = pipeline(), plain = pipeline();
  ASSERT_TRUE(played && plain);
  draw(*played, 0), draw(*plain, 0);
  ASSERT_TRUE(played->play_object(name(), {.speed = 0}));
  const Image<Rgb> held = draw(*played, .2);
  EXPECT_EQ(apart(draw(*played, .6), held), 0) << "held";
  const Image<Rgb> truth = draw(*plain, .4);
  EXPECT_GT(apart(truth, held), 1e-3) << "another pose";
  ASSERT_TRUE(played->play_object(name(), {.clip_time_s = .4, .speed = 1}));
  EXPECT_LT(apart(draw(*played, .9), truth), 1e-4);
  EXPECT_LT(apart(draw(*played, 1.1), draw(*plain, .6)), 1e-4) << "and goes on from there";
}

TEST(StandingHeight, IsWhatAQuarterOfTheFramesShare) {
  std::vector<float> lows(32, 0.f);
  EXPECT_EQ(standing_height(lows, 2), 0);
  lows[5] = -.3f;  // a foot that goes through the floor
  EXPECT_EQ(standing_height(lows, 2), 0);
  for (std::size_t i = 8; i < 24; ++i) lows[i] = .5f;  // a jump
  EXPECT_EQ(standing_height(lows, 2), 0);
  for (std::size_t i = 0; i < 32; ++i) lows[i] = .1f * static_cast<float>(i);  // a flight
  EXPECT_EQ(standing_height(lows, 2), 0) << "the lowest of all";
  EXPECT_EQ(standing_height({.7f}, 2), .7f);
}

// Lifted by its lowest frame a clip floats in all the others.
TEST(Animated, OneFrameThatReachesDeeperDoesNotLiftTheOthers) {
  const test::TempFolder folder;
  const auto file = folder.path() / "dip.gltf";
  test::write_dipping_tetrahedron(file, .4f);
  Scene scene = walker_scene();
  SceneObject& thing = scene.objects[0];
  thing.asset = file;
  thing.animation = "Dip";
  thing.live = true;
  thing.place_on_floor = true;
  thing.fit_size_m = 2;
  const auto prepared = prepare_quickly(scene, 64);
  ASSERT_TRUE(prepared) << prepared.error().detail;
  const auto low = [&](double t) { return bounds_of(prepared->objects[0].mesh_at(t)).low.y; };
  EXPECT_NEAR(low(.1), 0, 1e-3);
  EXPECT_NEAR(low(.5), -.8, .01);
}

TEST(Animated, AScenePlaysAFileThatWasBakedBefore) {
  const test::TempFolder folder;
  const auto [file, half_extent] = coarse_walk(folder, {.7f, .7f, .7f});
  Scene scene = walker_scene();
  scene.objects[0].albedo = {.7f, .7f, .7f};
  scene.objects[0].transfer = file;
  scene.objects[0].scale = 2;
  scene.objects[0].rotation = glm::angleAxis(1., glm::dvec3(0, 1, 0));
  auto prepared = prepare_quickly(scene);
  ASSERT_TRUE(prepared) << prepared.error().detail;
  const prt::Bounds b = prt::bounds_of(prepared->objects[0].mesh_at(.3));
  EXPECT_NEAR(b.high.y - b.low.y, 3.5, .16);
  EXPECT_NEAR(b.low.y, 0, .05);
  EXPECT_NEAR(prepared->objects[0].baked.receiver->grid.half_extent, 2 * half_extent, 1e-4);
  scene.objects[0].albedo = {.2f, .7f, .7f};
  prepared = prepare_quickly(scene);
  ASSERT_FALSE(prepared);
  EXPECT_THAT(prepared.error().detail, HasSubstr("another mesh"));
  scene.objects[0].albedo = {.7f, .7f, .7f};
  scene.objects[0].rotation = glm::angleAxis(.5, glm::dvec3(1, 0, 0));
  prepared = prepare_quickly(scene);
  ASSERT_FALSE(prepared);
  EXPECT_THAT(prepared.error().detail, HasSubstr("cannot be tilted"));
}

// Poses that no clip has: traced for the moment, they must be right in kind.
TEST(AnimatedGroundTruth, ABlendOfClipsIsLitByLiveTransfer) {
  Scene scene = walker_scene();
  scene.objects[0].blend = "Wave";
  scene.objects[0].blend_weight = .4;
  scene.objects[0].live = true;
  const auto prepared = prepare_quickly(scene);
  ASSERT_TRUE(prepared) << prepared.error().detail;
  const PreparedObject& walker = prepared->objects[0];
  EXPECT_FALSE(walker.live);                                 // each stage traces its own
  EXPECT_GT(prt::bounds_of(walker.mesh_at(.3)).high.x, .5);  // an arm waves
  for (const auto& map :
       {capture::make_room_environment(512, 256), capture::make_sky_environment(512, 256, .8)}) {
    const Figures f = compare_with_reference(*prepared, map, 2, .02);
    std::printf("object %.2f %%, bias %.2f %%, shadow %.4f\n", 100 * f.object, 100 * f.bias,
                f.shadow);
    EXPECT_LT(f.object, .08);  // vertices stand twice as far apart as in a bake
    EXPECT_LT(std::abs(f.bias), .04);
    EXPECT_LT(f.shadow, .06);
  }
}

// Another weight of the second clip is another pose at the same time.
TEST(Animated, TheWeightOfASecondClipIsSetByACall) {
  Scene scene = walker_scene();
  scene.objects[0].blend = "Wave";
  const auto prepared = prepare_quickly(scene);
  ASSERT_TRUE(prepared);
  PreparedObject weighed = prepared->objects[0];
  ASSERT_TRUE(weighed.begin_live());
  EXPECT_TRUE(weighed.move_to(.2, {.blend_weight = 0.f}));
  const auto first_clip = weighed.baked.mesh.positions;
  EXPECT_FALSE(weighed.move_to(.2, {.blend_weight = 0.f}));
  EXPECT_TRUE(weighed.move_to(.2, {.blend_weight = 1.f}));
  double apart = 0;
  for (std::size_t v = 0; v < first_clip.size(); ++v)
    apart = std::max(apart, double(glm::distance(first_clip[v], weighed.baked.mesh.positions[v])));
  EXPECT_GT(apart, .02);
}

TEST(Animated, LiveTransferIsTheSameOnEveryRunAndKeepsTimeWhenAsked) {
  Scene scene = walker_scene();
  scene.objects[0].live = true;
  const auto prepared = prepare_quickly(scene);
  ASSERT_TRUE(prepared);
  prt::CowVector<std::uint16_t> first;
  for (int run = 0; run < 2; ++run) {
    PreparedObject o = prepared->objects[0];
    ASSERT_TRUE(o.begin_live());
    for (int frame = 0; frame < 4; ++frame) EXPECT_TRUE(o.move_to(frame / 60., {}));
    EXPECT_FALSE(o.move_to(3 / 60., {}));  // there already
    EXPECT_TRUE(o.move_to(-1, {}));        // a time like any other
    if (run == 0) first = o.baked.transfer.values;
    EXPECT_EQ(o.baked.transfer.values, first);
  }
  EXPECT_FALSE(prepared->objects[0].live);
  // A budget of next to nothing leaves next to nothing to trace: frames may not stop for it.
  auto hurried = std::make_shared<Animation>(*prepared->objects[0].animation);
  hurried->live_seconds = 1e-6;
  PreparedObject o = prepared->objects[0];
  o.animation = hurried;
  ASSERT_TRUE(o.begin_live());
  o.move_to(0, {.keep_time = true});
  const auto before = o.baked.transfer.values;
  for (int frame = 1; frame < 4; ++frame) o.move_to(frame / 60., {.keep_time = true});
  // What it has keeps its place, but for the few points that were visited.
  std::size_t same = 0;
  for (std::size_t i = 0; i < before.size(); ++i) same += before[i] == o.baked.transfer.values[i];
  EXPECT_GT(same, before.size() / 100);
  EXPECT_GT(*std::ranges::max_element(o.baked.transfer.values), 0);
}

// Without probes the governor predicts nothing of what left-out bands would have done.
TEST(Animated, TheGovernorKnowsACharactersShadow) {
  const test::TempFolder folder;
  Scene scene = walker_scene();
  scene.objects[0].transfer = coarse_walk(folder, scene.objects[0].albedo).file;
  for (const bool live : {false, true}) {
    scene.objects[0].live = live;
    if (live) scene.objects[0].transfer.clear();
    const auto prepared = prepare_quickly(scene);
    ASSERT_TRUE(prepared);
    const prt::Transfer& probes = prepared->objects[0].baked.shadow_probes;
    ASSERT_EQ(probes.points, std::size_t{prt::BakedObject::kShadowProbes}) << live;
    ASSERT_EQ(probes.bands, kMaxBands);
    for (std::size_t p = 0; p < probes.points; ++p) EXPECT_GT(probes.value(0, 0, p), 0);
  }
}

TEST(Animated, WhatDoesNotMoveSaysSo) {
  Scene scene = walker_scene();
  scene.objects[0].asset = "builtin:knot";
  auto prepared = prepare_quickly(scene);
  ASSERT_FALSE(prepared);
  EXPECT_THAT(prepared.error().detail, HasSubstr("builtin:walker"));
  scene = walker_scene();
  scene.objects[0].animation = "Fly";
  prepared = prepare_quickly(scene);
  ASSERT_FALSE(prepared);
  EXPECT_THAT(prepared.error().detail, HasSubstr("Walk, Wave, Rest"));
}

}  // namespace
}  // namespace penumbra::runtime
