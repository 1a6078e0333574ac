// From rig.toml's [pose] to the picture: a board that the view camera sees, the pose of each frame,
// the object on the board in the distorted picture of a real lens.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <utility>

#include "calib/camera/camera_model.h"
#include "prt/prt.h"
#include "runtime/pipeline/pipeline.h"
#include "service/poses/pose_config.h"
#include "service/quick_rig.h"
#include "service/rig_config.h"
#include "service/still_environment.h"
#include "tests/support/board_pictures.h"
#include "tests/support/gl.h"
#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

using glm::dvec2;
using glm::dvec3;

constexpr int kBoardFrames = 40, kLostFrom = 15, kLostTo = 27;
constexpr double kChainFps = 30;

calib::CameraModel webcam_lens() {
  calib::CameraModel out{calib::ProjectionKind::kPinhole, 640, 480, {520, 520}, {323, 236},
                         {-.18, .05, .001, 0, 0}};
  return out;
}

// A camera in the hand that goes around a board, which somebody covers for a while.
class HandheldFilm : public capture::FrameSource {
 public:
  // The light comes from a camera of its own or, without it, from elsewhere.
  explicit HandheldFilm(bool with_light = true, int frames = kBoardFrames) : frames_(frames) {
    cameras_.resize(with_light ? 2 : 1);
    capture::CameraInfo& webcam = cameras_.back();
    webcam.name = "webcam";
    webcam.role = capture::Role::kView;
    webcam.projection = webcam_lens();
    webcam.response = calib::Response::srgb();
    if (with_light) {
      cameras_[0].name = "surroundings";
      cameras_[0].projection = *calib::make_projection(calib::ProjectionKind::kLatLong, 64, 32);
      capture::Frame light;
      light.exposure = {Seconds(1), Gain(1)};
      light.time = time_of(0);
      light.pixels = std::make_shared<const FramePixels>(even_light());
      light_ = light;
    }
  }

  static Image<Rgb> even_light() { return {64, 32, Rgb{.4f, .35f, .3f}}; }
  static calib::Board board() { return *calib::parse_board("charuco:8x6:0.03:0.022"); }
  static Pose camera_at(int i) {
    const double t = i / kChainFps;
    return test::looking_at({.09 + .2 * t, .42 + .05 * t, .42}, {.09 + .1 * t, .01, .06}, .1 * t);
  }
  static TimestampNs time_of(int i) { return TimestampNs{7'000'000'000} + Seconds(i / kChainFps); }

  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  Result<std::optional<capture::Frame>> next() override {
    if (light_) return std::exchange(light_, std::nullopt);
    if (painted_ == frames_) return std::optional<capture::Frame>();
    const int i = painted_++;
    test::PictureFaults faults;
    faults.seed = static_cast<unsigned>(i);
    if (i >= kLostFrom && i < kLostTo) faults.covered = {0, 0, 640, 480};
    capture::Frame frame;
    frame.camera = static_cast<int>(cameras_.size()) - 1;
    frame.sequence = static_cast<std::uint64_t>(i);
    frame.exposure = {Seconds(1), Gain(1)};
    frame.time = time_of(i);
    frame.pixels =
        std::make_shared<const FramePixels>(painter_.paint({drawn_}, camera_at(i), faults));
    return std::optional(frame);
  }
  double view_rate() const override { return kChainFps; }

 private:
  std::vector<capture::CameraInfo> cameras_;
  std::optional<capture::Frame> light_;
  test::BoardPainter painter_{webcam_lens()};
  test::DrawnBoard drawn_ = test::draw_board(board(), calib::world_from_flat_board(board()));
  int frames_, painted_ = 0;  // painted as they are asked for: most tests need a few
};

runtime::Scene box_on_the_board() {
  runtime::Scene scene;
  runtime::SceneObject box;
  box.name = "box";
  box.asset = "builtin:box";
  box.fit_size_m = .05;
  box.position = {.09, 0, .06};
  scene.objects.push_back(box);
  runtime::RealGeometry floor;
  floor.plane = runtime::RealPlane{};
  floor.albedo = Rgb{.6f, .6f, .6f};
  scene.real.push_back(floor);
  return scene;
}

// The middle of what the object covers: darker or brighter than the camera's picture by a lot.
std::optional<dvec2> middle_of_change(const FramePixels& before, const FramePixels& after) {
  const auto &a = std::get<Image<Rgb8>>(before), &b = std::get<Image<Rgb8>>(after);
  dvec2 sum(0);
  double weight = 0;
  for (int y = 0; y < a.height(); ++y)
    for (int x = 0; x < a.width(); ++x)
      if (std::abs(int(a.at(x, y).g) - int(b.at(x, y).g)) > 0)
        sum += dvec2(x + .5, y + .5), weight += 1;
  if (weight < 100) return std::nullopt;
  return sum / weight;
}

TEST(PoseChain, AnObjectStaysOnItsBoardBeforeAHandheldLensAndFadesWhileTheBoardIsCovered) {
  PoseConfig config;
  config.source = "board";
  config.boards = {{HandheldFilm::board(), calib::world_from_flat_board(HandheldFilm::board())}};
  auto posed = with_poses(std::make_unique<HandheldFilm>(), config, nullptr);
  ASSERT_TRUE(posed) << posed.error().detail;
  PipelineOptions options;
  options.bake = runtime::BakeSettings::coarse();
  options.bake.rays = options.bake.ground_rays = 64;
  options.bake.max_edge_fraction = .2f;
  options.bake.bounces = 1;
  options.bake.cache = runtime::BakeCache::kNotUsed;
  auto pipeline = Pipeline::create((*posed)->cameras(), box_on_the_board(), options);
  PENUMBRA_NEED_GL(pipeline);
  ASSERT_TRUE(pipeline) << pipeline.error().detail;
  struct Seen {
    float opacity;
    std::shared_ptr<const FramePixels> camera, composited;
    double turn_rad, off_m;
  };
  std::vector<Seen> seen;
  const auto counts = pipeline->replay(**posed, [&](const runtime::Output& out) {
    const Pose truth = HandheldFilm::camera_at(static_cast<int>(out.source.sequence));
    const glm::dquat turn = glm::conjugate(truth.rotation) * out.source.world_from_camera.rotation;
    seen.push_back({out.source.opacity, out.source.pixels, out.pixels,
                    2 * std::asin(std::min(1., glm::length(dvec3(turn.x, turn.y, turn.z)))),
                    glm::distance(truth.translation, out.source.world_from_camera.translation)});
    return true;
  });
  ASSERT_TRUE(counts) << counts.error().detail;
  ASSERT_EQ(seen.size(), std::size_t(kBoardFrames));

  // Where the object would be with the true poses.
  HandheldFilm film;
  auto truth = Pipeline::create(film.cameras(), box_on_the_board(), options);
  ASSERT_TRUE(truth);
  double worst_px = 0;
  int compared = 0;
  while (const auto frame = *film.next()) {
    if (frame->camera == 0) {
      ASSERT_TRUE(*truth->add_environment(*frame));
      continue;
    }
    const auto i = static_cast<std::size_t>(frame->sequence);
    if (seen[i].opacity < 1) continue;
    capture::Frame placed = *frame;
    placed.world_from_camera = HandheldFilm::camera_at(static_cast<int>(i));
    const auto expected = truth->composite(placed);
    ASSERT_TRUE(expected);
    const auto there = middle_of_change(*frame->pixels, expected->pixels),
               here = middle_of_change(*seen[i].camera, *seen[i].composited);
    ASSERT_TRUE(there && here) << i;
    worst_px = std::max(worst_px, glm::distance(*there, *here));
    EXPECT_LT(seen[i].turn_rad, .0035) << i;
    EXPECT_LT(seen[i].off_m, .003) << i;
    ++compared;
  }
  std::printf("object off by %.2f px at most over %d frames\n", worst_px, compared);
  EXPECT_LT(worst_px, 1.5);
  EXPECT_GT(compared, 20);

  // It goes within a quarter of a second, and what is left is the camera's picture to the bit.
  for (int i = kLostFrom; i < kLostTo; ++i) {
    const auto& frame = seen[static_cast<std::size_t>(i)];
    if ((i - kLostFrom) / kChainFps > .25) {
      EXPECT_EQ(*frame.camera, *frame.composited) << i;
    }
    if (i > kLostFrom + 1) {
      EXPECT_LE(frame.opacity, seen[static_cast<std::size_t>(i - 1)].opacity) << i;
    }
  }
  EXPECT_LT(seen[kLostTo - 1].opacity, .01);
  EXPECT_EQ(seen.back().opacity, 1);
}

// The light of a file, whose units nobody knows, is as bright as the board's paper says.
TEST(PoseChain, AMapIsScaledByThePaperOfTheBoard) {
  PoseConfig config;
  config.source = "board";
  config.boards = {{HandheldFilm::board(), calib::world_from_flat_board(HandheldFilm::board())}};
  constexpr int kFrames = 20;  // a map comes each half second
  auto posed = with_poses(std::make_unique<HandheldFilm>(false, kFrames), config, nullptr);
  ASSERT_TRUE(posed) << posed.error().detail;
  auto lit = StillEnvironment::create(
      std::move(*posed), {.map = HandheldFilm::even_light(), .scale = {}, .boards = config.boards});
  ASSERT_TRUE(lit) << lit.error().detail;
  ASSERT_EQ((*lit)->cameras().size(), 2u);
  // The painter's paper has the code 225; under an even sky it sends albedo times radiance.
  const double paper = calib::Response::srgb().decode(225 / 255., 0);
  int maps = 0, views = 0;
  std::optional<TimestampNs> before;
  while (const auto frame = *(*lit)->next()) {
    views += frame->camera == 0;
    if (frame->camera == 0) continue;
    const Rgb& p = std::get<Image<Rgb>>(*frame->pixels).at(5, 9);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(p[c] * .8 / paper, 1, .06) << c;
    if (before) {
      EXPECT_GE((frame->time - *before).count(), .2);
    }
    before = frame->time;
    ++maps;
  }
  EXPECT_EQ(views, kFrames);
  EXPECT_GE(maps, 2);
  // Without a board nobody can tell.
  const auto blind = StillEnvironment::create(std::make_unique<HandheldFilm>(false),
                                              {.map = HandheldFilm::even_light(), .boards = {}});
  ASSERT_FALSE(blind);
  EXPECT_THAT(blind.error().detail, ::testing::HasSubstr("environment_scale"));
  // Two lights are one too many.
  const auto twice =
      StillEnvironment::create(std::make_unique<HandheldFilm>(),
                               {.map = HandheldFilm::even_light(), .scale = 1, .boards = {}});
  ASSERT_FALSE(twice);
  EXPECT_THAT(twice.error().detail, ::testing::HasSubstr("shows it, too"));
}

TEST(QuickRig, IsACameraABoardAndAnObjectOnItsMiddle) {
  const auto played = quick_rig({.source = "film.mkv", .environment = "room.hdr"});
  ASSERT_TRUE(played) << played.error().detail;
  EXPECT_EQ(played->source, "film.mkv");
  ASSERT_EQ(played->pose->boards.size(), 1u);
  // The middle of the board is the world's origin: half of seven squares to the right.
  const dvec3 corner = played->pose->boards[0].world_from_board * dvec3(0);
  EXPECT_NEAR(glm::distance(corner, dvec3(-.09, 0, -.06)), 0, 1e-9);
  ASSERT_EQ(played->own_scene->objects.size(), 1u);
  EXPECT_EQ(played->light_environment, "room.hdr");
  EXPECT_EQ(played->port, 8787);
  const auto nowhere = quick_rig({.source = "/dev/video97"});
  ASSERT_FALSE(nowhere);
  EXPECT_EQ(nowhere.error().where, "/dev/video97");
  EXPECT_EQ(nowhere.error().code, ErrorCode::kNotFound);
  EXPECT_FALSE(quick_rig({.source = "film.mkv", .board = "charuco:8"}));
  EXPECT_FALSE(quick_rig({.source = "film.mkv", .size_m = 0}));
  const auto lens = quick_rig({.source = "film.mkv", .lens = "nowhere.toml"});
  ASSERT_FALSE(lens);
  EXPECT_EQ(lens.error().where, "--lens");
}

class PoseKeys : public ::testing::Test {
 protected:
  Result<RigConfig> read(const std::string& pose, const std::string& more = "") {
    std::ofstream(folder_.path() / "scene.toml") << "version = 1\n";
    std::ofstream(folder_.path() / "rig.toml")
        << "version = 1\n[capture]\nsource = \"film.mkv\"\n[scene]\nfile = \"scene.toml\"\n"
        << more << "[pose]\n"
        << pose;
    return read_rig_config(folder_.path() / "rig.toml");
  }
  void expect_refused(const std::string& word, const std::string& pose) {
    const auto config = read(pose);
    ASSERT_FALSE(config) << pose;
    EXPECT_THAT(config.error().detail, ::testing::HasSubstr(word)) << pose;
  }
  test::TempFolder folder_;
};

TEST_F(PoseKeys, TellWhereEachFramesPoseComesFrom) {
  const auto board = read(
      "source = \"board\"\nboards = [{ board = \"charuco:8x6:0.03:0.022\", plane = \"wall\" }]\n");
  ASSERT_TRUE(board) << board.error().detail;
  ASSERT_EQ(board->pose->boards.size(), 1u);
  // On a wall the paper's up is the world's.
  const Pose& wall = board->pose->boards[0].world_from_board;
  EXPECT_NEAR(glm::distance(wall.rotation * dvec3(0, 1, 0), dvec3(0, 1, 0)), 0, 1e-9);
  EXPECT_NEAR(glm::length(wall.translation), 0, 1e-9);
  const auto stream = read("source = \"stream\"\nport = 0\nclock = \"arrival\"\n",
                           "[output]\nopenxr = true\n[headset]\npicture_distance_m = 1.5\n");
  ASSERT_TRUE(stream) << stream.error().detail;
  EXPECT_TRUE(stream->pose->by_arrival);
  EXPECT_EQ(stream->pose->port, 0);
  EXPECT_TRUE(stream->openxr);
  EXPECT_EQ(stream->headset.picture_distance_m, 1.5);
  const auto track = read("source = \"track\"\nfile = \"head.csv\"\nclock_offset_s = -0.5\n");
  ASSERT_TRUE(track) << track.error().detail;
  EXPECT_EQ(track->pose->file, folder_.path() / "head.csv");
  const auto hand = read("source = \"openxr\"\ndevice = \"left\"\n");
  ASSERT_TRUE(hand) << hand.error().detail;
  EXPECT_EQ(hand->pose->device, "left");
}

TEST_F(PoseKeys, ThatMeanNothingAreRefused) {
  expect_refused("\"guess\"", "source = \"guess\"\n");
  expect_refused("boards", "source = \"board\"\n");
  expect_refused("either a socket or a port", "source = \"stream\"\n");
  expect_refused("either a socket or a port", "source = \"stream\"\nport = 1\nsocket = \"a\"\n");
  expect_refused("belongs to source = \"track\"", "source = \"openxr\"\nfile = \"a.csv\"\n");
  expect_refused("belongs to source = \"openxr\"",
                 "source = \"stream\"\nport = 1\ndevice = \"left\"\n");
  expect_refused("none of \"head\"", "source = \"openxr\"\ndevice = \"foot\"\n");
  expect_refused("neither \"sender\" nor \"arrival\"",
                 "source = \"stream\"\nport = 1\nclock = \"mine\"\n");
  expect_refused("did you mean \"clock_offset_s\"",
                 "source = \"track\"\nfile = \"a\"\nclock_offset = 1\n");
  expect_refused("charuco", "source = \"board\"\nboards = [{ board = \"charuco:8\" }]\n");
  expect_refused("rigid",
                 "source = \"board\"\nboards = [{ board = \"charuco:8x6:0.03:0.022\", "
                 "world_from_board = [2,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1] }]\n");
  std::ofstream(folder_.path() / "studio.toml")
      << "version = 1\n[capture]\nsource = \"studio\"\n[pose]\nsource = \"openxr\"\n";
  const auto studio = read_rig_config(folder_.path() / "studio.toml");
  ASSERT_FALSE(studio);
  EXPECT_THAT(studio.error().detail, ::testing::HasSubstr("the studio's cameras stand"));
}

TEST(PoseChain, CamerasThatDoNotExistAndSeveralWithoutACalibrationAreRefused) {
  PoseConfig config;
  config.source = "board";
  config.boards = {{HandheldFilm::board(), {}}};
  config.cameras = {"webcam", "nobody"};
  const auto unknown = with_poses(std::make_unique<HandheldFilm>(), config, nullptr);
  ASSERT_FALSE(unknown);
  EXPECT_THAT(unknown.error().detail, ::testing::HasSubstr("nobody"));
  config.cameras = {"webcam", "surroundings"};
  const auto several = with_poses(std::make_unique<HandheldFilm>(), config, nullptr);
  ASSERT_FALSE(several);
  EXPECT_THAT(several.error().detail, ::testing::HasSubstr("calibration"));
}

}  // namespace
}  // namespace penumbra::service
