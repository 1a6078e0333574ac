// Light from several pictures of the surroundings: two lenses, two cameras, a mirror ball.
#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <thread>

#include "calib/calib.h"
#include "capture/capture.h"
#include "codec/codec.h"
#include "core/conventions.h"
#include "lighting/lighting.h"
#include "runtime/pipeline/internal/frame_mailbox.h"
#include "runtime/pipeline/light_estimation_stage.h"
#include "tests/support/ball_pictures.h"
#include "tests/support/shared_data.h"

namespace penumbra::runtime {

namespace {

using capture::CameraInfo;
using glm::dvec3;

constexpr int kViewWidth = 512, kViewHeight = 256;
const glm::dquat kBack = glm::angleAxis(kPi, dvec3(0, 1, 0));

using Sky = std::function<Rgb(const dvec3&)>;

Sky room() {
  auto map =
      std::make_shared<const Image<Rgb>>(capture::make_room_environment(kViewWidth, kViewHeight));
  return [map](const dvec3& d) {
    const glm::dvec2 px = latlong_pixel(d, kViewWidth, kViewHeight);
    return map->at(std::min(static_cast<int>(px.x), kViewWidth - 1),
                   std::min(static_cast<int>(px.y), kViewHeight - 1));
  };
}
Sky grey(float value) {
  return [value](const dvec3&) { return Rgb{value, value, value}; };
}

calib::CameraModel fisheye(int side, double fov_deg) {
  calib::CameraModel p = *calib::make_projection(calib::ProjectionKind::kEquidistant, side, side);
  p.focal_px = glm::dvec2(side / (fov_deg / 180 * kPi));
  return p;
}

// What is outside the lens's field is black, as in real pictures.
void draw(const capture::Lens& lens, const glm::dquat& world_from_camera, const Sky& sky, Rgb gain,
          Image<Rgb>& out) {
  for (int y = 0; y < lens.projection.height; ++y)
    for (int x = 0; x < lens.projection.width; ++x) {
      Rgb sum{};
      for (int s = 0; s < 16; ++s) {
        const auto d = calib::direction_from_pixel(lens.projection,
                                                   {x + (s % 4 + .5) / 4, y + (s / 4 + .5) / 4});
        if (d && std::acos(-d->z) <= lens.half_field_of_view_rad)
          sum += sky(world_from_camera * (lens.camera_from_lens * *d));
      }
      out.at(lens.x_px + x, lens.y_px + y) = sum * gain * (1.f / 16);
    }
}

capture::Frame frame_of(int camera, Image<Rgb> pixels, double seconds = 0) {
  capture::Frame frame;
  frame.camera = camera;
  frame.time = TimestampNs{static_cast<std::int64_t>(seconds * 1e9)};
  frame.exposure = {Seconds(1), Gain(1)};
  frame.pixels = std::make_shared<const FramePixels>(std::move(pixels));
  return frame;
}

RadianceSh truth_of(const Sky& sky) {
  Image<Rgb> map(kViewWidth, kViewHeight);
  for (int y = 0; y < kViewHeight; ++y)
    for (int x = 0; x < kViewWidth; ++x)
      map.at(x, y) = sky(latlong_direction(x + .5, y + .5, kViewWidth, kViewHeight));
  StageTimes times;
  CameraInfo camera;
  camera.projection =
      *calib::make_projection(calib::ProjectionKind::kLatLong, kViewWidth, kViewHeight);
  auto stage = *LightEstimationStage::create({camera}, {3, {0, .02}}, times);
  return stage.process(frame_of(0, map))->light;
}

// Largest difference of a coefficient, of the largest one.
double difference(const RadianceSh& a, const RadianceSh& truth) {
  double worst = 0, largest = 0;
  for (std::size_t i = 0; i < truth.terms().size(); ++i)
    for (int c = 0; c < 3; ++c) {
      worst = std::max(worst, std::abs(double(a.terms()[i][c] - truth.terms()[i][c])));
      largest = std::max(largest, std::abs(double(truth.terms()[i][c])));
    }
  return worst / largest;
}

CameraInfo two_lenses(double fov_deg) {
  CameraInfo camera;
  camera.name = "dual";
  for (const int i : {0, 1})
    camera.lenses.push_back({240 * i, 0, fisheye(240, fov_deg),
                             i == 0 ? glm::dquat(1, 0, 0, 0) : kBack, fov_deg / 360 * kPi});
  camera.projection = camera.lenses[0].projection;
  camera.projection.width = 480;
  return camera;
}

Image<Rgb> picture_of(const CameraInfo& camera, const Sky& sky, const std::vector<Rgb>& gains) {
  Image<Rgb> out(camera.projection.width, camera.projection.height);
  for (std::size_t i = 0; i < camera.lenses.size(); ++i)
    draw(camera.lenses[i], camera.world_from_camera.rotation, sky, gains[i], out);
  return out;
}

constexpr Rgb kOne{1, 1, 1}, kOther{1.4f, 1.2f, .8f};

TEST(SeveralViews, ConstantRadianceThroughTwoUnequalLensesHasNoSeam) {
  const CameraInfo camera = two_lenses(200);
  for (const Rgb& gain : {kOne, kOther}) {
    StageTimes times;
    auto stage = *LightEstimationStage::create({camera}, {3, {0, .02}}, times);
    const auto estimate = stage.process(frame_of(0, picture_of(camera, grey(2), {kOne, gain})));
    ASSERT_TRUE(estimate) << estimate.error().detail;
    EXPECT_EQ(estimate->coverage, 1);
    EXPECT_LT(difference(estimate->light, truth_of(grey(2))), .002);
    EXPECT_TRUE(stage.ready());
  }
}

TEST(SeveralViews, APictureOfAnotherSizeIsRefusedByName) {
  StageTimes times;
  auto stage = *LightEstimationStage::create({two_lenses(200)}, {3, {0, .02}}, times);
  const auto small = stage.process(frame_of(0, Image<Rgb>(240, 120, {1, 1, 1})));
  ASSERT_FALSE(small);
  EXPECT_EQ(small.error().code, ErrorCode::kInvalid);
  EXPECT_EQ(small.error().where, "dual frame 0");
  EXPECT_EQ(small.error().detail, "has 240x120 pixels instead of 480x240");
}

TEST(SeveralViews, TwoLensesOfOnePictureShowTheWholeRoom) {
  CameraInfo camera = two_lenses(200);
  camera.world_from_camera.rotation = glm::angleAxis(.7, glm::normalize(dvec3(.2, 1, .1)));
  const RadianceSh truth = truth_of(room());
  const auto estimate_with = [&](const CameraInfo& info, const Rgb& gain) {
    StageTimes times;
    auto stage = *LightEstimationStage::create({info}, {3, {0, .02}}, times);
    capture::Frame frame = frame_of(0, picture_of(camera, room(), {kOne, gain}));
    frame.world_from_camera = camera.world_from_camera;
    const auto estimate = stage.process(frame);
    EXPECT_TRUE(estimate);
    return estimate ? estimate->light : RadianceSh(3);
  };
  const double equal = difference(estimate_with(camera, kOne), truth),
               unequal = difference(estimate_with(camera, kOther), truth);
  std::printf("two lenses: coefficients off by %.2f %%, of unequal gain by %.2f %%\n", 100 * equal,
              100 * unequal);
  EXPECT_LT(equal, .01);
  EXPECT_LT(unequal, .015);
  // As if the lenses saw half the sphere each, they overlap nowhere and the second one's gain stays
  // in the light.
  CameraInfo apart = camera;
  for (capture::Lens& l : apart.lenses) l.half_field_of_view_rad = kPi / 2;
  EXPECT_GT(difference(estimate_with(apart, kOther), truth), .05);
}

TEST(SeveralViews, VignettedLensesMakeAConstantMapOnceTheirVignettingIsKnown) {
  CameraInfo camera = two_lenses(200);
  const std::array<double, 3> terms{-.35, .1, -.15};
  Image<Rgb> picture = picture_of(camera, grey(2), {kOne, kOne});
  for (const capture::Lens& lens : camera.lenses) {
    const Vignetting left = calib::vignetting_of(lens.projection, terms);
    for (int y = 0; y < 240; ++y)
      for (int x = 0; x < 240; ++x)
        picture.at(lens.x_px + x, y) =
            picture.at(lens.x_px + x, y) * static_cast<float>(left.at({x + .5, y + .5}));
  }
  const auto estimate = [&] {
    StageTimes times;
    auto stage = *LightEstimationStage::create({camera}, {3, {0, .02}}, times);
    return stage.process(frame_of(0, picture))->light;
  };
  EXPECT_GT(difference(estimate(), truth_of(grey(2))), .05);
  camera.vignetting = terms;
  EXPECT_LT(difference(estimate(), truth_of(grey(2))), .003);
}

TEST(SeveralViews, TwoCamerasAreBlendedAndTheStalestTellsTheTime) {
  std::vector<CameraInfo> cameras(2);
  for (int i = 0; i < 2; ++i) {
    CameraInfo& c = cameras[static_cast<std::size_t>(i)];
    c.name = i == 0 ? "front" : "back";
    c.projection = fisheye(240, 200);
    c.lenses = {{0, 0, c.projection, {1, 0, 0, 0}, 100. / 180 * kPi}};
    c.world_from_camera.rotation = i == 0 ? glm::dquat(1, 0, 0, 0) : kBack;
  }
  StageTimes times;
  auto stage = *LightEstimationStage::create(cameras, {3, {0, .02}}, times);
  ASSERT_TRUE(stage.process(frame_of(0, picture_of(cameras[0], room(), {kOne}), 1)));
  EXPECT_FALSE(stage.ready()) << "half the room is still missing";
  capture::Frame back = frame_of(1, picture_of(cameras[1], room(), {kOther}), 2);
  back.world_from_camera = cameras[1].world_from_camera;
  const auto both = stage.process(back);
  ASSERT_TRUE(both);
  EXPECT_TRUE(stage.ready());
  EXPECT_EQ(both->time.value, 1'000'000'000);
  EXPECT_LT(difference(both->light, truth_of(room())), .015);
  // One camera alone goes on; its light is as old as the silent one's last picture.
  for (int i = 0; i < 5; ++i) {
    const auto next = stage.process(frame_of(0, picture_of(cameras[0], room(), {kOne}), 3 + i));
    ASSERT_TRUE(next);
    EXPECT_EQ(next->time.value, 2'000'000'000);
  }
}

TEST(SeveralViews, CameraThatNeverShowsAnythingIsNotWaitedForForEver) {
  std::vector<CameraInfo> cameras(2);
  for (CameraInfo& c : cameras) c.projection = fisheye(64, 180);
  StageTimes times;
  auto stage = *LightEstimationStage::create(cameras, {3, {0, .02}}, times);
  int frames = 0;
  while (!stage.ready() && frames < 100)
    ASSERT_TRUE(stage.process(frame_of(0, Image<Rgb>(64, 64, {1, 1, 1}), .03 * frames++)));
  EXPECT_LT(frames, 40);
}

// A street by a real camera of two lenses: what both see is told apart by less than their noise and
// the people near it.
TEST(SeveralViews, RealDualFisheyeHasGainsNearOne) {
  PENUMBRA_NEED_SHARED(path, "eval-only/calibration/dual_fisheye/extract.png");
  auto pixels = codec::read_frame(path);
  ASSERT_TRUE(pixels);
  CameraInfo camera;
  camera.name = "street";
  camera.response = calib::Response::srgb();
  for (const int i : {0, 1}) {
    calib::CameraModel p = *calib::make_projection(calib::ProjectionKind::kEquidistant, 1280, 1280);
    p.focal_px = {375, 375};
    p.principal_px = {640, 625};
    camera.lenses.push_back(
        {1280 * i, 0, p, i == 0 ? glm::dquat(1, 0, 0, 0) : kBack, 96. / 180 * kPi});
  }
  camera.projection = camera.lenses[0].projection;
  camera.projection.width = 2560;
  StageTimes times;
  auto stage = *LightEstimationStage::create({camera}, {3, {0, .02}}, times);
  capture::Frame frame = frame_of(0, {});
  frame.pixels = std::make_shared<const FramePixels>(std::move(*pixels));
  const auto estimate = stage.process(frame);
  ASSERT_TRUE(estimate) << estimate.error().detail;
  EXPECT_EQ(estimate->coverage, 1);
  const auto gains = stage.gains();
  ASSERT_EQ(gains.size(), 2u);
  EXPECT_TRUE(gains[1].known);
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(gains[1].gain[c], 1, .06);
}

// The ball as the camera sees it, perspective and all.
Image<Rgb> picture_with_ball(const CameraInfo& view, const calib::MirrorBall& ball,
                             const Sky& sky) {
  const auto& p = view.projection;
  Image<Rgb> out(p.width, p.height, {.3f, .3f, .3f});
  for (int y = 0; y < p.height; ++y)
    for (int x = 0; x < p.width; ++x) {
      Rgb sum{};
      int hits = 0;
      for (int s = 0; s < 16; ++s) {
        const auto ray =
            calib::direction_from_pixel(p, {x + (s % 4 + .5) / 4, y + (s / 4 + .5) / 4});
        if (const auto d = test::reflected(ball, *ray))
          sum += sky(view.world_from_camera.rotation * *d), ++hits;
      }
      if (hits > 0) out.at(x, y) = sum * (1.f / static_cast<float>(hits)) * view.ball_reflectance;
    }
  return out;
}

struct BallScene {
  CameraInfo view;
  calib::MirrorBall ball;
};
BallScene ball_scene(double distance_radii) {
  CameraInfo view;
  view.name = "view";
  view.role = capture::Role::kView;
  view.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 640, 480);
  view.world_from_camera = {glm::angleAxis(.4, glm::normalize(dvec3(.3, 1, 0))), {.2, 1.5, .8}};
  view.ball_reflectance = {.6f, .58f, .55f};
  const dvec3 centre = glm::normalize(dvec3(.25, -.1, -1)) * distance_radii * .05;
  view.ball = {{}, view.world_from_camera * centre, .05};
  return {view, *calib::MirrorBall::at(centre, .05)};
}

TEST(SeveralViews, MirrorBallInTheViewPictureShowsTheRoom) {
  const RadianceSh truth = truth_of(room());
  for (const double distance : {4., 8.}) {
    const BallScene scene = ball_scene(distance);
    const Image<Rgb> picture = picture_with_ball(scene.view, scene.ball, room());
    StageTimes times;
    auto stage = *LightEstimationStage::create({scene.view}, {3, {0, .02}}, times);
    EXPECT_TRUE(stage.takes(0));
    capture::Frame frame = frame_of(0, picture);
    frame.world_from_camera = scene.view.world_from_camera;
    const auto estimate = stage.process(frame);
    ASSERT_TRUE(estimate) << estimate.error().detail;
    EXPECT_LT(difference(estimate->light, truth), .015) << distance;
    EXPECT_GT(estimate->coverage, .9);
    // The textbook's ball, far away and straight ahead, laid over the same pixels.
    const auto visibility =
        capture::camera_regions(scene.view, scene.view.world_from_camera)->front();
    CameraInfo naive;
    naive.projection = *calib::make_projection(calib::ProjectionKind::kMirrorBall, visibility.width,
                                               visibility.height);
    naive.colour = glm::dmat3(1 / .6, 0, 0, 0, 1 / .58, 0, 0, 0, 1 / .55);
    Image<Rgb> mirrored(visibility.width, visibility.height);
    const FramePixels cut = capture::cut_out(FramePixels(picture), visibility);
    for (int y = 0; y < visibility.height; ++y)
      for (int x = 0; x < visibility.width; ++x)
        mirrored.at(x, y) = std::get<Image<Rgb>>(cut).at(visibility.width - 1 - x, y);
    naive.world_from_camera.rotation = scene.view.world_from_camera.rotation * kBack;
    auto textbook = *LightEstimationStage::create({naive}, {3, {0, .02}}, times);
    capture::Frame other = frame_of(0, mirrored);
    other.world_from_camera = naive.world_from_camera;
    EXPECT_GT(difference(textbook.process(other)->light, truth), distance < 5 ? .08 : .04);
  }
}

TEST(SeveralViews, BallIsFollowedWhenTheCameraMovesAndMissedWhenItLeaves) {
  const RadianceSh truth = truth_of(room());
  const BallScene scene = ball_scene(6);
  StageTimes times;
  auto stage = *LightEstimationStage::create({scene.view}, {3, {0, .02}}, times);
  const auto look = [&](const Pose& pose) {
    CameraInfo moved = scene.view;
    moved.world_from_camera = pose;
    const auto ball = calib::MirrorBall::at(pose.inverse() * scene.view.ball->centre_m, .05);
    const auto& size = moved.projection;
    capture::Frame frame = frame_of(0, ball ? picture_with_ball(moved, *ball, room())
                                            : Image<Rgb>(size.width, size.height, {.3f, .3f, .3f}));
    frame.world_from_camera = pose;
    return stage.process(frame);
  };
  Pose pose = scene.view.world_from_camera;
  for (int i = 0; i < 3; ++i) {
    pose.translation += dvec3(.02, .01, -.01);
    const auto estimate = look(pose);
    ASSERT_TRUE(estimate) << estimate.error().detail;
    EXPECT_LT(difference(estimate->light, truth), .02) << i;
  }
  const auto gone = look({pose.rotation * kBack, pose.translation});
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().code, ErrorCode::kUndetermined);
  EXPECT_TRUE(stage.environment().radiance.empty());
  const auto inside = look({pose.rotation, scene.view.ball->centre_m + dvec3(.01, 0, 0)});
  ASSERT_FALSE(inside);
  EXPECT_EQ(inside.error().code, ErrorCode::kUndetermined) << "a tracker's jump ends nothing";
  EXPECT_EQ(inside.error().where, "view");
  EXPECT_TRUE(look(pose)) << "back in the picture";
}

// The measure stays the first view's while it is away.
TEST(SeveralViews, GainsStayWhenAViewComesAndGoesOrIsCovered) {
  Environment one, two, dark;
  one.radiance = Image<Rgb>(64, 32, {1, 1, 1});
  two.radiance = Image<Rgb>(64, 32, {.25f, .25f, .25f});
  dark.radiance = Image<Rgb>(64, 32, {1e-3f, 1e-3f, 1e-3f});
  capture::EnvironmentBlend blend(2);
  for (const std::size_t i : {0, 1}) blend.set_view(i, Image<float>(64, 32, 1.f));
  Environment out;
  const auto mean = [&](const Environment* a, const Environment* b) {
    const Environment* const views[] = {a, b};
    blend.blend(views, out);
    return out.radiance.at(30, 15).g;
  };
  EXPECT_NEAR(mean(&one, &two), 1, 1e-3);
  blend.set_view(0, {});
  EXPECT_NEAR(mean(nullptr, &two), 1, 1e-3);
  blend.set_view(0, Image<float>(64, 32, 1.f));
  EXPECT_NEAR(mean(&one, &two), 1, 1e-3);
  for (int i = 0; i < 50; ++i) mean(&one, &dark);
  EXPECT_NEAR(blend.gains()[1].g, 4, .01) << "a covered camera is not amplified";
}

TEST(SeveralViews, ACameraThatIsSilentDoesNotHideWhatSaturatesTheOther) {
  std::vector<CameraInfo> cameras(2);
  for (CameraInfo& c : cameras) {
    c.projection = fisheye(64, 180);
    c.response = calib::Response::srgb();
  }
  StageTimes times;
  auto stage = *LightEstimationStage::create(cameras, {3, {4, .02}}, times);
  Image<Rgb8> picture(64, 64, {90, 90, 90});
  for (int y = 20; y < 28; ++y)
    for (int x = 30; x < 38; ++x) picture.at(x, y) = {255, 255, 255};
  Result<lighting::LightEstimate> last = fail(ErrorCode::kClosed, "", "");
  for (int i = 0; i < 6; ++i) {
    capture::Frame frame = frame_of(0, {}, .03 * i);
    frame.pixels = std::make_shared<const FramePixels>(picture);
    last = stage.process(frame);
  }
  ASSERT_TRUE(last);
  EXPECT_FALSE(stage.environment().clipped.empty());
  EXPECT_GT(last->clipped_fraction, 0);
}

TEST(SeveralViews, WhatSaturatesOneCameraCountsInTheOtherAlone) {
  Environment bright, dark;
  for (Environment* e : {&bright, &dark}) e->radiance = Image<Rgb>(32, 16, {1, 1, 1});
  bright.radiance.at(7, 7) = {40, 40, 40};
  dark.radiance.at(7, 7) = {5, 5, 5};
  dark.clipped = {7 * 32 + 7};
  capture::EnvironmentBlend blend(2);
  for (const std::size_t i : {0, 1}) blend.set_view(i, Image<float>(32, 16, 1.f));
  const Environment* const views[] = {&dark, &bright};
  Environment out;
  blend.blend(views, out);
  EXPECT_NEAR(out.radiance.at(7, 7).g, 40, .1) << "the mean would be 22";
  EXPECT_TRUE(out.clipped.empty());
  bright.clipped = dark.clipped;
  blend.blend(views, out);
  EXPECT_EQ(out.clipped, dark.clipped);
  EXPECT_GT(out.clipped_fraction, 0);
}

// Something near one camera alone, over a quarter of the overlap, does not move the gains.
TEST(SeveralViews, SomeoneBeforeOneCameraDoesNotMoveTheGains) {
  Environment a, b;
  a.radiance = Image<Rgb>(64, 32, {1, 1, 1});
  b.radiance = Image<Rgb>(64, 32, {.5f, .5f, .5f});
  for (int y = 0; y < 32; ++y)
    for (int x = 0; x < 16; ++x) b.radiance.at(x, y) = {3, 3, 3};
  capture::EnvironmentBlend blend(2);
  for (const std::size_t i : {0, 1}) blend.set_view(i, Image<float>(64, 32, 1.f));
  const Environment* const views[] = {&a, &b};
  Environment out;
  blend.blend(views, out);
  EXPECT_NEAR(blend.gains()[1].g, 2, .01) << "the ratio of the means is .89";
}

TEST(FrameMailbox, SlowReaderOfAnEvenBracketStillSeesEveryExposure) {
  Latest<capture::Frame> plain;
  FrameMailbox box;
  std::map<double, int> seen, seen_plain;
  for (int i = 0; i < 400; ++i) {
    capture::Frame frame = frame_of(0, Image<Rgb>(2, 2), .01 * i);
    frame.exposure.time = Seconds(i % 2 == 0 ? .01 : .001);
    plain.put(frame);
    box.put(frame);
    if (i % 2 == 0) continue;  // twice as slow as the camera
    if (const auto got = box.wait(Seconds(0))) ++seen[got->exposure.time.count()];
    if (const auto got = plain.take()) ++seen_plain[got->exposure.time.count()];
  }
  EXPECT_EQ(seen_plain.size(), 1u) << "a plain mailbox shows one exposure alone";
  ASSERT_EQ(seen.size(), 2u);
  for (const auto& [exposure, count] : seen) EXPECT_GE(count, 80) << exposure;
}

TEST(FrameMailbox, CamerasDoNotDropEachOthersFramesAndCloseLetsGo) {
  FrameMailbox box;
  box.put(frame_of(0, Image<Rgb>(2, 2), 0));
  box.put(frame_of(1, Image<Rgb>(2, 2), 1));
  box.put(frame_of(0, Image<Rgb>(2, 2), 2));
  EXPECT_EQ(box.dropped(), 1u);
  EXPECT_EQ(box.wait(Seconds(0))->time.value, 2'000'000'000);
  EXPECT_EQ(box.wait(Seconds(0))->camera, 1);
  std::jthread closer([&] { box.close(); });
  EXPECT_FALSE(box.wait(Seconds(20)));
  EXPECT_TRUE(box.closed());
}

}  // namespace
}  // namespace penumbra::runtime
