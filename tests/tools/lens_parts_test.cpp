// A 360-degree camera whose lenses do not look exactly away from each other.
#include "tools/calibrate/lens_parts.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <glm/gtc/quaternion.hpp>

#include "calib/calib.h"
#include "core/conventions.h"
#include "tests/support/board_pictures.h"

namespace penumbra::tools {
namespace {

constexpr int kLensSide = 640;
constexpr double kHalfView = 100 * kPi / 180, kApart_m = .018;

capture::CameraInfo two_lenses() {
  capture::CameraInfo out;
  out.name = "two";
  out.projection =
      *calib::make_projection(calib::ProjectionKind::kEquidistant, 2 * kLensSide, kLensSide);
  for (int k = 0; k < 2; ++k) {
    capture::Lens lens;
    lens.x_px = k * kLensSide;
    lens.projection =
        *calib::make_projection(calib::ProjectionKind::kEquidistant, kLensSide, kLensSide);
    lens.projection.focal_px = glm::dvec2(.5 * kLensSide / kHalfView);
    lens.half_field_of_view_rad = kHalfView;
    lens.camera_from_lens = glm::angleAxis(k * kPi, glm::dvec3(0, 1, 0));
    out.lenses.push_back(lens);
  }
  return out;
}

// Both lenses' pictures side by side.
FramePixels side_by_side(const Image<Rgb8>& a, const Image<Rgb8>& b) {
  Image<Rgb8> out(2 * kLensSide, kLensSide);
  for (int y = 0; y < kLensSide; ++y)
    for (int x = 0; x < kLensSide; ++x)
      out.at(x, y) = a.at(x, y), out.at(kLensSide + x, y) = b.at(x, y);
  return out;
}

TEST(LensParts, ABoardAtTheSeamTellsHowTheLensesLook) {
  const capture::CameraInfo camera = two_lenses();
  const glm::dquat off = glm::angleAxis(1.7 * kPi / 180, glm::normalize(glm::dvec3(.5, .7, -.4)));
  const glm::dquat truth = camera.lenses[1].camera_from_lens * off;
  const Pose first{}, second{truth, {0, 0, kApart_m}};
  const calib::Board board = *calib::parse_board("charuco:8x6:0.04:0.03");
  const test::BoardPainter painter(camera.lenses[0].projection);
  const std::vector<RigPart> parts = parts_of(camera, 0);
  ASSERT_EQ(parts.size(), 2u);
  EXPECT_EQ(parts[1].input.name, "two lens 2");
  std::vector<calib::RigObservation> seen;
  constexpr int kMoments = 8;
  std::array<int, 2> found{};
  for (int m = 0; m < kMoments; ++m) {
    // Around the seam, facing the camera, in turns nearer and tilted.
    const double round = 2 * kPi * m / kMoments, away = m % 2 ? .34 : .42;
    const glm::dvec3 out(std::cos(round), std::sin(round), .1 * std::sin(3. * m));
    const glm::dvec3 z = -glm::normalize(out + glm::dvec3(0, .25 * std::cos(2. * m), .2)),
                     x = glm::normalize(glm::cross(glm::dvec3(0, 0, 1), z)), y = glm::cross(z, x);
    const Pose turned{glm::quat_cast(glm::dmat3(x, y, z)), away * out};
    const Pose board_at{turned.rotation, turned * glm::dvec3(-.12, .08, 0)};
    const test::DrawnBoard drawn = test::draw_board(board, board_at);
    const auto paint = [&](const Pose& lens, unsigned seed) {
      return std::get<Image<Rgb8>>(painter.paint({drawn}, lens, {.seed = seed}));
    };
    const FramePixels frame = side_by_side(paint(first, 2 * m), paint(second, 2 * m + 1));
    for (std::size_t k = 0; k < parts.size(); ++k)
      if (auto view = calib::find_board(picture_of(parts[k], camera, frame), board, "frame")) {
        seen.push_back({k, .5 * m, std::move(*view)});
        ++found[k];
      }
  }
  ASSERT_GE(std::min(found[0], found[1]), kMoments / 2) << found[0] << ' ' << found[1];
  const std::vector<calib::RigCameraInput> inputs{parts[0].input, parts[1].input};
  const auto rig = calib::calibrate_rig(inputs, seen);
  ASSERT_TRUE(rig) << rig.error().detail;
  const std::vector<Pose> poses{rig->cameras[0].rig_from_camera, rig->cameras[1].rig_from_camera};
  const std::vector<JoinedCamera> joined = join(parts, poses, {camera});
  ASSERT_EQ(joined.size(), 1u);
  ASSERT_EQ(joined[0].lenses.size(), 2u);
  const auto degrees = [](const glm::dquat& a, const glm::dquat& b) {
    return 2 * std::acos(std::min(1., std::abs(glm::dot(a, b)))) * 180 / kPi;
  };
  const double error = degrees(joined[0].lenses[1].camera_from_lens, truth);
  std::printf("two lenses: found to %.3f degrees, %.1f mm apart; said to be %.2f degrees off\n",
              error, 1000 * joined[0].apart_m[1], joined[0].turned_rad[1] * 180 / kPi);
  EXPECT_LT(error, .1) << "taken as said, it is 1.7";
  EXPECT_NEAR(joined[0].turned_rad[1] * 180 / kPi, 1.7, .1);
  EXPECT_NEAR(joined[0].apart_m[1], kApart_m, .002);
  EXPECT_EQ(joined[0].lenses[0].camera_from_lens, camera.lenses[0].camera_from_lens);
}

TEST(LensParts, ACameraOfOneLensIsItself) {
  capture::CameraInfo camera;
  camera.name = "one";
  camera.projection = *calib::make_projection(calib::ProjectionKind::kPinhole, 64, 48);
  const std::vector<RigPart> parts = parts_of(camera, 3);
  ASSERT_EQ(parts.size(), 1u);
  EXPECT_EQ(parts[0].input.name, "one");
  const FramePixels whole = Image<Rgb8>(64, 48);
  EXPECT_TRUE(picture_of(parts[0], camera, whole) == whole);
  const Pose pose{glm::angleAxis(.3, glm::dvec3(0, 1, 0)), {1, 2, 3}};
  const auto joined = join(parts, std::vector{pose}, std::vector<capture::CameraInfo>(4, camera));
  ASSERT_EQ(joined.size(), 1u);
  EXPECT_EQ(joined[0].camera, 3u);
  EXPECT_TRUE(joined[0].pose == pose);
  EXPECT_TRUE(joined[0].lenses.empty());
}

}  // namespace
}  // namespace penumbra::tools
