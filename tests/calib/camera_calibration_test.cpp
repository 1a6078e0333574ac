#include "calib/calib.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#define GLM_ENABLE_EXPERIMENTAL
#include <glm/gtx/quaternion.hpp>
#include <random>

#include "codec/codec.h"
#include "core/conventions.h"
#include "tests/calib/projections.h"
#include "tests/support/shared_data.h"

namespace penumbra::calib {
namespace {

using testing::HasSubstr;

constexpr int kLensWidth = 1000, kLensHeight = 750;
constexpr double kNoisePx = .2;
constexpr int kColumns = 9, kRows = 6;
constexpr double kSquare = .03;

CameraModel truth(ProjectionKind kind) {
  CameraModel p = projection(kind, kLensWidth, kLensHeight);
  p.principal_px = {493.9, 377.9};
  switch (kind) {
    case kKannalaBrandt:
      p.focal_px = {436.4, 435.2};
      return *with_distortion(p, std::vector{.038, .041, -.031, .0077});
    case kDoubleSphere:
      p.focal_px = {300, 299};  // 195 degrees across the diagonal and more
      return *with_distortion(p, std::vector{-.18, .59});
    case kPinhole:
      p.focal_px = {870, 868};
      return *with_distortion(p, std::vector{-.21, .08, .0008, -.0005, -.02});
    default:
      p.focal_px = {436.4, 435.2};
      return p;
  }
}

// How a hand holds a board: somewhere in view, tilted by up to 45 degrees.
std::vector<BoardView> simulate(const CameraModel& camera, int count, std::uint32_t seed,
                                double max_tilt = .8, double spread = 1, bool flat = false) {
  std::mt19937 random(seed);
  std::normal_distribution<double> noise(0, kNoisePx);
  std::uniform_real_distribution<double> unit(-1, 1);
  // One number a statement: compilers differ in which argument they draw first.
  const auto draw = [&random](auto& from) {
    const double y = from(random);
    return glm::dvec2(from(random), y);
  };
  std::vector<BoardView> out;
  while (static_cast<int>(out.size()) < count) {
    const glm::dvec2 aim =
        glm::dvec2(kLensWidth, kLensHeight) / 2. * (1. + .85 * spread * draw(unit));
    const auto towards = direction_from_pixel(camera, aim);
    if (!towards) continue;
    const double along = .4 * unit(random);
    const glm::dvec3 axis(draw(unit), along);
    // Turned first as it is held, then towards the camera.
    const glm::dquat face =
        flat ? glm::dquat(1, 0, 0, 0) : glm::rotation(glm::dvec3(0, 0, -1), *towards);
    const glm::dquat tilt = glm::angleAxis(max_tilt * unit(random), glm::normalize(axis));
    const glm::dvec3 centre = *towards * (.25 + .25 * std::abs(unit(random)));
    BoardView view{.name = "board " + std::to_string(out.size()), .pixels = {}, .on_board_m = {}};
    for (int i = 0; i < kColumns * kRows; ++i) {
      const glm::dvec2 at = kSquare * glm::dvec2(i % kColumns, i / kColumns);
      const glm::dvec3 local(at.x - kSquare * (kColumns - 1) / 2, kSquare * (kRows - 1) / 2 - at.y,
                             0);
      const auto pixel = pixel_from_direction(camera, centre + face * (tilt * local));
      if (!pixel) continue;
      view.on_board_m.push_back(at);
      view.pixels.push_back(*pixel + draw(noise));
    }
    if (view.pixels.size() == kColumns * kRows) out.push_back(std::move(view));
  }
  return out;
}

struct Parameter {
  double found, sigma, truth;
};

std::vector<Parameter> parameters(const CameraCalibration& c, const CameraModel& truth) {
  std::vector<Parameter> out;
  for (int i = 0; i < 2; ++i) {
    out.push_back({c.projection.focal_px[i], c.focal_sigma_px[i], truth.focal_px[i]});
    out.push_back({c.projection.principal_px[i], c.principal_sigma_px[i], truth.principal_px[i]});
  }
  for (std::size_t i = 0; i < static_cast<std::size_t>(distortion_count(truth.kind)); ++i)
    out.push_back({c.projection.distortion[i], c.distortion_sigma[i], truth.distortion[i]});
  return out;
}

class CameraCalibrationOf : public testing::TestWithParam<ProjectionKind> {};

// Two standard deviations hold the truth in 95.4 % of all cases, for each parameter of each lens.
TEST_P(CameraCalibrationOf, UncertaintyCoversTheTruth) {
  constexpr int kRuns = 200;
  const CameraModel camera = truth(GetParam());
  std::vector<int> covered;
  double worst_rms = 0, min_rms = 1;
  for (std::uint32_t run = 0; run < kRuns; ++run) {
    const auto result =
        calibrate_camera(simulate(camera, 12, run + 1), camera.kind, kLensWidth, kLensHeight);
    ASSERT_TRUE(result) << "run " << run << ": " << result.error().detail;
    worst_rms = std::max(worst_rms, result->rms_px);
    min_rms = std::min(min_rms, result->rms_px);
    const auto list = parameters(*result, camera);
    covered.resize(list.size());
    for (std::size_t i = 0; i < list.size(); ++i)
      covered[i] += std::abs(list[i].found - list[i].truth) <= 1.96 * list[i].sigma;
  }
  // RMS of two-dimensional errors.
  EXPECT_NEAR(worst_rms, kNoisePx * std::sqrt(2), .04);
  EXPECT_NEAR(min_rms, kNoisePx * std::sqrt(2), .04);
  int all = 0;
  for (const int n : covered) {
    EXPECT_GE(n, 180) << "90 %: four standard deviations below 95 % of 200";
    all += n;
  }
  const double fraction = static_cast<double>(all) / static_cast<double>(kRuns * covered.size());
  std::printf("%s: truth within 1.96 sigma in %.1f %% of %d runs\n",
              std::string(projection_name(camera.kind)).c_str(), 100 * fraction, kRuns);
  EXPECT_GE(fraction, .93);
  EXPECT_LE(fraction, .99) << "the uncertainty is overstated";
}

// Corners end at 15 degrees: what the sixth power does beyond is chance, and may fold the lens
// back. Such pictures were refused whole, good as they are.
TEST(CameraCalibration, PicturesThatEndNearTheAxisLeaveTheHighestTermsOut) {
  CameraModel camera = truth(kPinhole);
  camera.focal_px = {1300, 1298};
  camera = *with_distortion(camera, std::vector{-.12, .05, .0008, -.0005, 0.});
  int left_out = 0, fitted = 0;
  constexpr int kRuns = 40;
  for (std::uint32_t run = 0; run < kRuns; ++run) {
    auto views = simulate(camera, 10, run + 1, .8, .7);
    for (BoardView& v : views)
      for (std::size_t i = v.pixels.size(); i-- > 0;)
        if (glm::length(v.pixels[i] - camera.principal_px) > .27 * 1300) {
          v.pixels.erase(v.pixels.begin() + static_cast<std::ptrdiff_t>(i));
          v.on_board_m.erase(v.on_board_m.begin() + static_cast<std::ptrdiff_t>(i));
        }
    std::erase_if(views, [](const BoardView& v) { return v.pixels.size() < 16; });
    const auto result = calibrate_camera(views, kPinhole, kLensWidth, kLensHeight);
    if (!result) {
      EXPECT_EQ(result.error().detail.find("monotone"), std::string::npos)
          << "run " << run << ": " << result.error().detail;
      continue;
    }
    ++fitted;
    EXPECT_LT(result->rms_px, 2 * kNoisePx);
    left_out += result->distortion_fixed[4];
    EXPECT_EQ(result->distortion_fixed[4], result->projection.distortion[4] == 0);
  }
  std::printf("%d of %d fitted, the highest term left out in %d\n", fitted, kRuns, left_out);
  EXPECT_GT(fitted, kRuns / 2);
  EXPECT_GT(left_out, 0) << "the test shows nothing";
}

INSTANTIATE_TEST_SUITE_P(All, CameraCalibrationOf,
                         testing::Values(kEquidistant, kKannalaBrandt, kDoubleSphere, kPinhole),
                         [](const auto& tested) {
                           std::string name(projection_name(tested.param));
                           std::erase(name, '-');
                           return name;
                         });

TEST(CameraCalibration, PosesOfTheBoardsAreInOurAxes) {
  const CameraModel camera = truth(kPinhole);
  // A board one metre ahead, facing the camera, its first corner above and left of the axis.
  std::vector<BoardView> views = simulate(camera, 10, 3);
  BoardView facing{.name = "facing", .pixels = {}, .on_board_m = {}};
  for (int i = 0; i < kColumns * kRows; ++i) {
    const glm::dvec2 at = kSquare * glm::dvec2(i % kColumns, i / kColumns);
    facing.on_board_m.push_back(at);
    facing.pixels.push_back(*pixel_from_direction(camera, {at.x - .1, .05 - at.y, -1}));
  }
  views.push_back(facing);
  const auto result = calibrate_camera(views, kPinhole, kLensWidth, kLensHeight);
  ASSERT_TRUE(result) << result.error().detail;
  const Pose& pose = result->boards.back().camera_from_board;
  EXPECT_LT(glm::length(pose.translation - glm::dvec3(-.1, .05, -1)), .004);
  EXPECT_GT(std::abs(pose.rotation.w), .9999);
}

TEST(CameraCalibration, ABoardThatContradictsTheOthersIsNamed) {
  const CameraModel camera = truth(kKannalaBrandt);
  std::vector<BoardView> views = simulate(camera, 12, 5);
  std::mt19937 random(1);
  std::normal_distribution<double> bent(0, 3);  // a board that moved while the shutter was open
  for (glm::dvec2& p : views[7].pixels) p += glm::dvec2(bent(random), bent(random));
  const auto result = calibrate_camera(views, camera.kind, kLensWidth, kLensHeight);
  ASSERT_TRUE(result) << result.error().detail;
  for (const BoardFit& b : result->boards) EXPECT_EQ(b.used, b.name != "board 7") << b.name;
  EXPECT_LT(result->rms_px, .32);
  EXPECT_GT(result->boards[7].rms_px, 3);
  EXPECT_NEAR(result->projection.focal_px.x, camera.focal_px.x, 4 * result->focal_sigma_px.x);
}

TEST(CameraCalibration, RefusesWhatCannotBeKnownAndSaysWhatToCapture) {
  const auto reason = [](std::span<const BoardView> views, ProjectionKind kind) {
    const auto result = calibrate_camera(views, kind, kLensWidth, kLensHeight);
    EXPECT_FALSE(result);
    if (result) return std::string();
    EXPECT_EQ(result.error().code, ErrorCode::kUndetermined);
    return result.error().detail;
  };
  const CameraModel pinhole = truth(kPinhole), fisheye = truth(kKannalaBrandt);
  EXPECT_THAT(reason(simulate(pinhole, 2, 1), kPinhole), HasSubstr("found in 2 pictures"));
  // Boards held flat before a pinhole: a longer lens from farther away looks the same.
  EXPECT_THAT(reason(simulate(pinhole, 12, 1, .01, .3, true), kPinhole), HasSubstr("tilted by"));
  EXPECT_THAT(reason(simulate(fisheye, 12, 1, .8, .05), kKannalaBrandt),
              HasSubstr("board to the borders"));
  const auto kind = calibrate_camera(simulate(pinhole, 4, 1), kLatLong, kLensWidth, kLensHeight);
  EXPECT_EQ(kind.error().code, ErrorCode::kInvalid);
  // The wrong model is no calibration: it shows in the residuals, which are told.
  const auto wrong =
      calibrate_camera(simulate(fisheye, 12, 1), kEquidistant, kLensWidth, kLensHeight);
  ASSERT_TRUE(wrong);
  EXPECT_GT(wrong->rms_px, 1);
}

// ------------------------------------------------------------------------------- real pictures

std::vector<BoardView> look(const std::filesystem::path& folder, const std::string& prefix,
                            const Board& board, int& pictures) {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (entry.path().filename().string().starts_with(prefix)) files.push_back(entry.path());
  std::ranges::sort(files);
  pictures = static_cast<int>(files.size());
  std::vector<BoardView> views;
  for (const auto& file : files) {
    const auto pixels = codec::read_frame(file);
    EXPECT_TRUE(pixels);
    if (auto view = find_board(*pixels, board, file.stem().string())) views.push_back(*view);
  }
  return views;
}

TEST(RealBoards, GoProFisheye) {
  PENUMBRA_NEED_SHARED(folder, "eval-only/calibration/fisheye_gopro");
  int pictures = 0;
  const auto views = look(folder, "3D_", *parse_board("chessboard:15x9:0.026"), pictures);
  EXPECT_GE(views.size(), 22u);
  const auto result = calibrate_camera(views, kKannalaBrandt, 1000, 750);
  ASSERT_TRUE(result) << result.error().detail;
  std::printf("GoPro: %.3f px RMS over %zu of %d pictures, focal %.2f %.2f +- %.2f %.2f\n",
              result->rms_px, views.size(), pictures, result->projection.focal_px.x,
              result->projection.focal_px.y, result->focal_sigma_px.x, result->focal_sigma_px.y);
  EXPECT_LE(result->rms_px, .35);
  // OpenCV 4.6's fisheye model on the same pictures; its pixels count from the centre of the first.
  EXPECT_NEAR(result->projection.focal_px.x, 436.93, 1.5);
  EXPECT_NEAR(result->projection.focal_px.y, 435.71, 1.5);
  EXPECT_NEAR(result->projection.principal_px.x, 493.70 + .5, 1.5);
  EXPECT_NEAR(result->projection.principal_px.y, 379.18 + .5, 2.5);
}

TEST(RealBoards, UnequalStereoPair) {
  PENUMBRA_NEED_SHARED(folder, "eval-only/calibration/stereo_unequal");
  struct Camera {
    const char* name;
    int width, height;
    double fx, fy, cx, cy, rms;
  };
  // The manifest's figures, +-2 %.
  for (const Camera& c : {Camera{"left", 960, 720, 987, 994, 557, 446, .34},
                          Camera{"right", 2592, 1944, 2541, 2546, 1358, 1085, .84}}) {
    int pictures = 0;
    const auto views = look(folder, c.name, *parse_board("chessboard:9x6:0.025"), pictures);
    EXPECT_EQ(views.size(), 8u);
    const auto result = calibrate_camera(views, kPinhole, c.width, c.height);
    ASSERT_TRUE(result) << result.error().detail;
    const CameraModel& p = result->projection;
    std::printf("%s: %.3f px RMS, focal %.1f %.1f, principal %.1f %.1f\n", c.name, result->rms_px,
                p.focal_px.x, p.focal_px.y, p.principal_px.x, p.principal_px.y);
    EXPECT_NEAR(p.focal_px.x, c.fx, .02 * c.fx);
    EXPECT_NEAR(p.focal_px.y, c.fy, .02 * c.fy);
    EXPECT_NEAR(p.principal_px.x, c.cx, .02 * c.fx);
    EXPECT_NEAR(p.principal_px.y, c.cy, .02 * c.fy);
    EXPECT_LE(result->rms_px, 1.02 * c.rms);
  }
}

}  // namespace
}  // namespace penumbra::calib
