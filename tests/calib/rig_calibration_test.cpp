#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <random>

#include "calib/calib.h"
#include "core/conventions.h"

namespace penumbra::calib {
namespace {

constexpr double kDegree = kPi / 180, kNoise_px = .2;
constexpr int kColumns = 9, kRows = 6;
constexpr double kSquare_m = .06;

glm::dquat turn(double degrees, const glm::dvec3& axis) {
  return glm::angleAxis(degrees * kDegree, glm::normalize(axis));
}

// A fisheye that looks up and forward, and a pair of view cameras.
std::vector<RigCameraInput> lenses() {
  CameraModel fisheye = *make_projection(ProjectionKind::kKannalaBrandt, 1000, 1000);
  fisheye.focal_px = {320, 320};
  fisheye = *with_distortion(fisheye, std::vector{.03, -.01, .002, 0.});
  CameraModel view = *make_projection(ProjectionKind::kPinhole, 1280, 720);
  view.focal_px = {900, 900};
  return {{"left", view}, {"right", view}, {"fisheye", fisheye}};
}
const std::vector<Pose> kRig = {{turn(0, {0, 1, 0}), {0, 0, 0}},
                                {turn(-4, {.1, 1, 0}), {.064, .002, .001}},
                                {turn(35, {1, .1, 0}), {.03, .11, .02}}};

struct Scene {
  std::vector<RigObservation> views;
  std::vector<TrackerPose> tracker;
};

void add_view(Scene& scene, std::size_t camera, double time_s, const Pose& camera_from_board,
              std::mt19937& rng) {
  static const auto cameras = lenses();
  std::normal_distribution<double> noise(0, kNoise_px);
  RigObservation out{camera, time_s, {}};
  out.view.name = cameras[camera].name + " at " + std::to_string(time_s);
  const CameraModel& lens = cameras[camera].projection;
  for (int i = 0; i < kColumns * kRows; ++i) {
    const glm::dvec2 at = kSquare_m * glm::dvec2(i % kColumns, i / kColumns);
    const auto pixel =
        pixel_from_direction(lens, glm::normalize(camera_from_board * glm::dvec3(at.x, -at.y, 0)));
    if (!pixel || pixel->x < 0 || pixel->y < 0 || pixel->x > lens.width || pixel->y > lens.height)
      return;
    out.view.on_board_m.push_back(at);
    out.view.pixels.push_back(*pixel + glm::dvec2(noise(rng), noise(rng)));
  }
  scene.views.push_back(std::move(out));
}

const Pose kCentred{{1, 0, 0, 0}, {-kSquare_m * (kColumns - 1) / 2, kSquare_m*(kRows - 1) / 2, 0}};

// A hand holds the board before the rig.
Scene moving_board(unsigned seed, int moments = 20) {
  std::mt19937 rng(seed);
  std::uniform_real_distribution<double> unit(-1, 1);
  Scene out;
  for (int m = 0; m < moments; ++m) {
    const glm::dvec3 axis(unit(rng), unit(rng), .5 * unit(rng));
    const Pose rig_from_board =
        Pose{turn(35 * unit(rng), axis),
             {.15 * unit(rng), .12 + .1 * unit(rng), -1.1 - .2 * unit(rng)}} *
        kCentred;
    for (std::size_t c = 0; c < kRig.size(); ++c)
      add_view(out, c, m, kRig[c].inverse() * rig_from_board, rng);
  }
  return out;
}

constexpr double kOffset_s = .0375;
const Pose kWorldFromBoard = Pose{turn(20, {0, 1, 0}), {.3, 1.2, -1.3}} * kCentred;
// Of the left camera on the tracked body; the others follow.
const Pose kBodyFromLeft{turn(8, {1, 2, .5}), {.02, -.05, .04}};

// Where the body is, with a hand's speed; `turns` about two axes or one.
Pose body_at(double t, double turns = 1) {
  return {turn(25 * std::sin(1.7 * t), {0, 1, 0}) * turn(turns * 20 * std::sin(2.3 * t), {1, 0, 0}),
          {.2 * std::sin(1.1 * t), 1.2 + turns * .1 * std::sin(1.9 * t), .1 * std::sin(.7 * t)}};
}

// The rig moves before a board that stands; a tracker follows it with a clock of its own.
Scene moving_rig(unsigned seed, double turns = 1, double speed = 1, double seconds = 6) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> gauss(0, 1);
  Scene out;
  constexpr double kFps = 10, kTrackerFps = 120;
  for (int i = 0; i < seconds * kFps; ++i) {
    const double t = i / kFps;
    const Pose world_from_body = body_at(speed * t, turns);
    for (std::size_t c = 0; c < kRig.size(); ++c)
      add_view(out, c, t, (world_from_body * kBodyFromLeft * kRig[c]).inverse() * kWorldFromBoard,
               rng);
  }
  for (int i = -60; i < (seconds + .5) * kTrackerFps; ++i) {
    const double t = i / kTrackerFps;
    Pose p = body_at(speed * t, turns);
    p.translation += .001 * glm::dvec3(gauss(rng), gauss(rng), gauss(rng));
    p.rotation = turn(.001 / kDegree * gauss(rng), {1, 0, 0}) *
                 turn(.001 / kDegree * gauss(rng), {0, 1, 0}) *
                 turn(.001 / kDegree * gauss(rng), {0, 0, 1}) * p.rotation;
    out.tracker.push_back({t + kOffset_s, p});
  }
  return out;
}

struct Distance {
  double place_m, turn_rad;
};
Distance distance(const Pose& a, const Pose& b) {
  const glm::dquat d = a.rotation * glm::conjugate(b.rotation);
  return {glm::length(a.translation - b.translation),
          2 * std::asin(std::min(1., glm::length(glm::dvec3(d.x, d.y, d.z))))};
}

TEST(BoardPose, IsRightAlsoFarFromTheAxis) {
  const auto cameras = lenses();
  std::mt19937 rng(1);
  for (const double degrees : {0., 40., 60.}) {  // its edge then lies at 75
    Scene scene;
    const Pose truth = Pose{turn(degrees, {0, 1, 0}), {0, 0, 0}} *
                       Pose{turn(20, {1, 0, 0}), {0, 0, -.9}} * kCentred;
    add_view(scene, 2, 0, truth, rng);
    ASSERT_EQ(scene.views.size(), 1u) << degrees;
    const auto found = board_pose(cameras[2].projection, scene.views[0].view);
    ASSERT_TRUE(found) << degrees;
    EXPECT_LT(distance(*found, truth).place_m, .02) << degrees;
    EXPECT_LT(distance(*found, truth).turn_rad, 1.5 * kDegree) << degrees;
  }
}

TEST(RigCalibration, ABoardThatSeveralCamerasSeeTellsTheirPlaces) {
  const auto found = calibrate_rig(lenses(), moving_board(1).views);
  ASSERT_TRUE(found) << found.error().detail;
  for (std::size_t c = 1; c < kRig.size(); ++c) {
    const Distance d = distance(found->cameras[c].rig_from_camera, kRig[c]);
    EXPECT_LT(d.place_m, .002) << c;
    EXPECT_LT(d.turn_rad, .1 * kDegree) << c;
  }
  EXPECT_NEAR(found->rms_px, kNoise_px, .03);
  EXPECT_TRUE(found->left_out.empty());
}

// Numbers of the poses of all cameras but the first that lie within 1.96 stated sigmas, and all.
std::pair<int, int> covered(const RigCalibration& found) {
  int inside = 0, all = 0;
  for (std::size_t c = 1; c < kRig.size(); ++c) {
    const RigCameraPose& p = found.cameras[c];
    const glm::dquat d = p.rig_from_camera.rotation * glm::conjugate(kRig[c].rotation);
    const glm::dvec3 turned = 2. * (d.w < 0 ? -1. : 1.) * glm::dvec3(d.x, d.y, d.z),
                     moved = p.rig_from_camera.translation - kRig[c].translation;
    for (int i = 0; i < 3; ++i) {
      inside += std::abs(moved[i]) < 1.96 * p.position_sigma_m[i];
      inside += std::abs(turned[i]) < 1.96 * p.rotation_sigma_rad[i];
      all += 2;
    }
  }
  return {inside, all};
}

TEST(RigCalibration, TheStatedUncertaintyCoversTheTruthInNinetyFivePercent) {
  int inside = 0, all = 0;
  for (unsigned seed = 0; seed < 200; ++seed) {
    const auto found = calibrate_rig(lenses(), moving_board(100 + seed, 8).views);
    ASSERT_TRUE(found) << seed << ' ' << found.error().detail;
    const auto [in, of] = covered(*found);
    inside += in, all += of;
  }
  EXPECT_NEAR(static_cast<double>(inside) / all, .95, .02);
}

// The same with lenses as calibrations find them: off by what they say. Taken as exact, they leave
// most of the truth outside.
TEST(RigCalibration, TheUncertaintyOfTheLensesCounts) {
  // Focal lengths by 2 px, almost together; the principal point by 3 px.
  constexpr double kFocal_px = 2, kTogether = .98, kPrincipal_px = 3;
  const std::vector<double> covariance = {kFocal_px * kFocal_px,
                                          kTogether * kFocal_px * kFocal_px,
                                          0,
                                          0,
                                          kTogether * kFocal_px * kFocal_px,
                                          kFocal_px * kFocal_px,
                                          0,
                                          0,
                                          0,
                                          0,
                                          kPrincipal_px * kPrincipal_px,
                                          0,
                                          0,
                                          0,
                                          0,
                                          kPrincipal_px * kPrincipal_px};
  int inside = 0, all = 0, inside_exact = 0;
  constexpr unsigned kRuns = 80;
  for (unsigned seed = 0; seed < kRuns; ++seed) {
    std::mt19937 rng(7000 + seed);
    std::normal_distribution<double> gauss(0, 1);
    std::vector<RigCameraInput> given = lenses();
    for (RigCameraInput& c : given) {
      const double both = std::sqrt(kTogether) * gauss(rng), own = std::sqrt(1 - kTogether);
      c.projection.focal_px += kFocal_px * (both + own * glm::dvec2(gauss(rng), gauss(rng)));
      c.projection.principal_px += kPrincipal_px * glm::dvec2(gauss(rng), gauss(rng));
    }
    const Scene scene = moving_board(300 + seed, 8);
    const auto exact = calibrate_rig(given, scene.views);
    for (RigCameraInput& c : given) c.lens_covariance = covariance;
    const auto found = calibrate_rig(given, scene.views);
    ASSERT_TRUE(exact && found) << seed;
    for (std::size_t c = 0; c < kRig.size(); ++c)
      EXPECT_EQ(
          distance(exact->cameras[c].rig_from_camera, found->cameras[c].rig_from_camera).place_m,
          0);
    const auto [in, of] = covered(*found);
    inside += in, all += of;
    inside_exact += covered(*exact).first;
  }
  std::printf("within 1.96 stated sigmas: %.1f %%, with lenses as exact %.1f %%\n",
              100. * inside / all, 100. * inside_exact / all);
  EXPECT_NEAR(static_cast<double>(inside) / all, .95, .04);
  EXPECT_LT(static_cast<double>(inside_exact) / all, .6);
}

TEST(RigCalibration, ALensCovarianceOfAnotherSizeIsRefused) {
  std::vector<RigCameraInput> given = lenses();
  given[1].lens_covariance.assign(25, 1);
  const auto found = calibrate_rig(given, moving_board(1).views);
  ASSERT_FALSE(found);
  EXPECT_EQ(found.error().where, "right");
  given[1].lens_covariance.assign(16, 0);
  given[1].lens_covariance[1] = 1;
  EXPECT_NE(calibrate_rig(given, moving_board(1).views).error().detail.find("symmetric"),
            std::string::npos);
  given[1].lens_covariance[4] = 1;  // symmetric, but for two variances of nothing
  EXPECT_EQ(calibrate_rig(given, moving_board(1).views).error().code, ErrorCode::kInvalid);
  given[1].lens_covariance.assign(16, std::nan(""));
  EXPECT_EQ(calibrate_rig(given, moving_board(1).views).error().code, ErrorCode::kNonFinite);
}

TEST(RigCalibration, ATrackersClockAndPlaceAreFound) {
  const Scene scene = moving_rig(3);
  RigOptions options;
  options.tracker = scene.tracker;
  const auto found = calibrate_rig(lenses(), scene.views, options);
  ASSERT_TRUE(found) << found.error().detail;
  ASSERT_TRUE(found->tracker_offset_s);
  EXPECT_NEAR(*found->tracker_offset_s, kOffset_s, .001);
  EXPECT_LT(found->tracker_offset_sigma_s, .0005);
  for (std::size_t c = 0; c < kRig.size(); ++c) {
    const Distance d = distance(found->cameras[c].rig_from_camera, kBodyFromLeft * kRig[c]);
    EXPECT_LT(d.place_m, .002) << c;
    EXPECT_LT(d.turn_rad, .1 * kDegree) << c;
  }
}

// Printed "to fit the page", or told in another unit: corners agree with each other as ever, and
// the camera's place would be wrong by a hundred of its stated sigmas.
TEST(RigCalibration, ABoardOfAnotherSizeIsToldByTheTrackersMetres) {
  for (const double factor : {1., 1.03, .97}) {
    Scene scene = moving_rig(7);
    for (RigObservation& o : scene.views)
      for (glm::dvec2& p : o.view.on_board_m) p *= factor;
    RigOptions options;
    options.tracker = scene.tracker;
    const auto found = calibrate_rig(lenses(), scene.views, options);
    if (factor == 1.) {
      ASSERT_TRUE(found) << found.error().detail;
      ASSERT_TRUE(found->board_scale);
      EXPECT_NEAR(*found->board_scale, 1, 3 * found->board_scale_sigma);
      EXPECT_LT(found->board_scale_sigma, .004);
    } else {
      ASSERT_FALSE(found) << factor;
      EXPECT_EQ(found.error().code, ErrorCode::kUndetermined);
      EXPECT_NE(found.error().detail.find("the tracker's metres"), std::string::npos);
    }
  }
}

TEST(RigCalibration, TheStatedUncertaintyOfTheClockAndTheBodyCoversTheTruth) {
  int offset = 0, place = 0;
  constexpr unsigned kRuns = 200;
  for (unsigned seed = 0; seed < kRuns; ++seed) {
    const Scene scene = moving_rig(50 + seed, 1, 1, 3);
    RigOptions options;
    options.tracker = scene.tracker;
    const auto found = calibrate_rig(lenses(), scene.views, options);
    ASSERT_TRUE(found) << found.error().detail;
    offset += std::abs(*found->tracker_offset_s - kOffset_s) < 1.96 * found->tracker_offset_sigma_s;
    const RigCameraPose& left = found->cameras[0];
    for (int i = 0; i < 3; ++i)
      place += std::abs(left.rig_from_camera.translation[i] - kBodyFromLeft.translation[i]) <
               1.96 * left.position_sigma_m[i];
  }
  RecordProperty("offset_covered", offset);
  RecordProperty("place_covered", place);
  EXPECT_NEAR(offset / double{kRuns}, .95, .035);
  EXPECT_NEAR(place / (3. * kRuns), .95, .035);
}

TEST(RigCalibration, ASlowTrackerTellsTheClockAsWell) {
  for (const std::size_t every : {8, 12}) {  // 15 and 10 poses a second
    const Scene scene = moving_rig(9);
    RigOptions options;
    for (std::size_t i = 0; i < scene.tracker.size(); i += every)
      options.tracker.push_back(scene.tracker[i]);
    const auto found = calibrate_rig(lenses(), scene.views, options);
    ASSERT_TRUE(found) << found.error().detail;
    EXPECT_NEAR(*found->tracker_offset_s, kOffset_s, .002) << every;
  }
}

TEST(RigCalibration, ATrackerThatWasSilentOrJumpedCostsLittle) {
  const Scene scene = moving_rig(10);
  const auto with = [&](const std::function<bool(TrackerPose&)>& keep) {
    RigOptions options;
    for (TrackerPose p : scene.tracker)
      if (keep(p)) options.tracker.push_back(p);
    const auto found = calibrate_rig(lenses(), scene.views, options);
    EXPECT_TRUE(found) << found.error().detail;
    if (!found) return;
    EXPECT_NEAR(*found->tracker_offset_s, kOffset_s, .0015);
    EXPECT_LT(distance(found->cameras[0].rig_from_camera, kBodyFromLeft).place_m, .005);
  };
  with([](const TrackerPose& p) { return p.time_s < 2 || p.time_s > 3.2; });
  with([](const TrackerPose& p) { return p.time_s < 3; });
  with([](TrackerPose& p) {
    if (p.time_s > 4 && p.time_s < 4.3) p.world_from_body.translation.x += .2;
    return true;
  });
}

TEST(RigCalibration, ABoardThatMovedBetweenTheCamerasIsNamed) {
  Scene scene = moving_board(4);
  for (glm::dvec2& p : scene.views[7].view.pixels) p.x += 15;
  const auto found = calibrate_rig(lenses(), scene.views);
  ASSERT_TRUE(found) << found.error().detail;
  ASSERT_EQ(found->left_out.size(), 1u);
  EXPECT_EQ(found->left_out[0], scene.views[7].view.name);
  EXPECT_LT(distance(found->cameras[2].rig_from_camera, kRig[2]).place_m, .002);
}

TEST(RigCalibration, RefusesWhatCannotTellTheAnswerAndSaysWhatToDo) {
  const auto refused = [](const std::vector<RigObservation>& views, const RigOptions& options,
                          const std::string& word) {
    const auto found = calibrate_rig(lenses(), views, options);
    ASSERT_FALSE(found) << word;
    EXPECT_NE(found.error().detail.find(word), std::string::npos) << found.error().detail;
  };
  refused({}, {}, "at least 2");
  Scene apart = moving_board(5);
  for (RigObservation& o : apart.views) o.time_s += .3 * static_cast<double>(o.camera);
  refused(apart.views, {}, "right never sees the board at the same moment");
  RigOptions one_axis;
  const Scene flat = moving_rig(6, 0);
  one_axis.tracker = flat.tracker;
  refused(flat.views, one_axis, "about two");
  RigOptions loose;
  const Scene hasty = moving_rig(7, 1, .4);
  loose.tracker = hasty.tracker;
  loose.tracker_sigma_m = .05, loose.tracker_sigma_rad = .05;
  refused(hasty.views, loose, "between the clocks stays uncertain");
  // Another order of the quaternion, another clock, a silent tracker.
  RigOptions wrong;
  wrong.tracker = hasty.tracker;
  for (TrackerPose& p : wrong.tracker) {
    const glm::dquat q = p.world_from_body.rotation;
    p.world_from_body.rotation = glm::dquat(q.z, q.w, q.x, q.y);
  }
  const auto mixed = calibrate_rig(lenses(), hasty.views, wrong);
  ASSERT_FALSE(mixed);
  EXPECT_EQ(mixed.error().code, ErrorCode::kUndetermined);
  RigOptions epoch;
  epoch.tracker = hasty.tracker;
  for (TrackerPose& p : epoch.tracker) p.time_s += 1.7e9;
  refused(hasty.views, epoch, "s apart");
  RigOptions few;
  few.tracker = {hasty.tracker[0], hasty.tracker[1]};
  refused(hasty.views, few, "has 2 poses");
  // A square that is half as large as it is said to be.
  Scene small = moving_rig(8);
  for (RigObservation& o : small.views)
    for (glm::dvec2& p : o.view.on_board_m) p *= 2.;
  RigOptions sized;
  sized.tracker = small.tracker;
  EXPECT_FALSE(calibrate_rig(lenses(), small.views, sized));
  RigOptions backwards;
  backwards.tracker = {{1, {}}, {1, {}}};
  EXPECT_EQ(calibrate_rig(lenses(), flat.views, backwards).error().code, ErrorCode::kInvalid);
}

}  // namespace
}  // namespace penumbra::calib
