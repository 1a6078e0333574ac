#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>
#include <map>

#include "calib/camera/pose_file.h"
#include "capture/poses/posed_source.h"
#include "core/conventions.h"

namespace penumbra::capture {
namespace {

using testing::HasSubstr;

constexpr int kView = 0, kSurroundings = 1, kFixed = 2;

TimestampNs after(double seconds) {
  return TimestampNs{1'000'000'000} + Seconds(seconds);
}

// A view camera and an environment camera on a body, and one beside them.
class FakeSource : public FrameSource {
 public:
  FakeSource() {
    for (const char* name : {"view", "surroundings", "fixed"}) {
      CameraInfo info;
      info.name = name;
      info.role = infos_.empty() ? Role::kView : Role::kEnvironment;
      infos_.push_back(info);
    }
    infos_[kFixed].world_from_camera.translation = {7, 0, 0};
  }
  void add(int camera, double seconds) {
    Frame frame;
    frame.camera = camera;
    frame.time = after(seconds);
    frame.world_from_camera = infos_[static_cast<std::size_t>(camera)].world_from_camera;
    frames_.push_back(frame);
  }
  const std::vector<CameraInfo>& cameras() const override { return infos_; }
  Result<std::optional<Frame>> next() override {
    if (frames_.empty()) return std::optional<Frame>();
    Frame out = frames_.front();
    frames_.pop_front();
    return out;
  }
  double view_rate() const override { return 59.94; }
  bool is_live() const override { return true; }
  void close() override { closed = true; }
  bool take_darker(int camera, double factor) override {
    darker = {camera, factor};
    return true;
  }
  std::vector<CameraCounts> counts() const override { return std::vector<CameraCounts>(3); }

  bool closed = false;
  std::pair<int, double> darker{-1, 0};

 private:
  std::vector<CameraInfo> infos_;
  std::deque<Frame> frames_;
};

// A body that moves along x at a metre a second, but for times in which nobody sees it.
class FakePoses : public PoseSource {
 public:
  std::optional<FramePose> pose_of(const Frame& frame) override {
    const double t = (frame.time - after(0)).count();
    asked.push_back(t);
    for (const auto& [from, to] : away)
      if (t >= from && t < to) return std::nullopt;
    return FramePose{{{1, 0, 0, 0}, {t, 0, 0}}, .001, .001, Seconds(0)};
  }
  PoseSourceState state() const override {
    PoseSourceState out;
    out.name = "fake";
    return out;
  }
  std::vector<std::pair<double, double>> away;
  std::vector<double> asked;
};

struct Made {
  FakeSource* frames;
  FakePoses* poses;
  std::unique_ptr<PosedSource> posed;
};

Made make(Seconds offset = Seconds(0)) {
  auto frames = std::make_unique<FakeSource>();
  auto poses = std::make_unique<FakePoses>();
  Made out{frames.get(), poses.get(), nullptr};
  const Pose view{glm::angleAxis(kPi / 2, glm::dvec3(0, 1, 0)), {0, .1, 0}},
      surroundings{{1, 0, 0, 0}, {0, .3, 0}};
  auto posed = PosedSource::create(std::move(frames), std::move(poses),
                                   {{{kView, view}, {kSurroundings, surroundings}}, offset});
  EXPECT_TRUE(posed);
  out.posed = std::move(*posed);
  return out;
}

TEST(PosedSource, GivesEachFrameThePoseOfItsOwnTime) {
  Made m = make();
  m.frames->add(kView, .1);
  m.frames->add(kSurroundings, .107);
  m.frames->add(kFixed, .11);
  m.frames->add(kView, .133);
  const Frame view = **m.posed->next(), around = **m.posed->next(), fixed = **m.posed->next(),
              later = **m.posed->next();
  EXPECT_NEAR(view.world_from_camera.translation.x, .1, 1e-9);
  EXPECT_NEAR(view.world_from_camera.translation.y, .1, 1e-9);
  EXPECT_NEAR(
      glm::length(view.world_from_camera.rotation * glm::dvec3(0, 0, -1) - glm::dvec3(-1, 0, 0)), 0,
      1e-9);
  EXPECT_NEAR(around.world_from_camera.translation.x, .107, 1e-9);
  EXPECT_NEAR(around.world_from_camera.translation.y, .3, 1e-9);
  EXPECT_EQ(fixed.world_from_camera.translation.x, 7);  // as it came
  EXPECT_NEAR(later.world_from_camera.translation.x, .133, 1e-9);
  EXPECT_EQ(view.time, after(.1));
  EXPECT_EQ(view.opacity, 1);
  EXPECT_FALSE(*m.posed->next());
}

TEST(PosedSource, AsksForTheTrackersTimeAndLeavesTheFramesItsOwn) {
  Made m = make(Seconds(.0375));  // camera time + offset = tracker time
  m.frames->add(kView, .1);
  const Frame view = **m.posed->next();
  ASSERT_EQ(m.poses->asked.size(), 1u);
  EXPECT_NEAR(m.poses->asked[0], .1375, 1e-9);
  EXPECT_NEAR(view.world_from_camera.translation.x, .1375, 1e-9);
  EXPECT_EQ(view.time, after(.1));
}

TEST(PosedSource, WhatIsVirtualFadesWithAnOldPoseAndComesBack) {
  Made m = make();
  m.poses->away = {{.5, 1.0}};
  for (int i = 0; i < 80; ++i) m.frames->add(kView, .02 * i);
  std::map<int, Frame> seen;
  for (int i = 0; i < 80; ++i) seen[i] = **m.posed->next();
  for (int i = 0; i < 25; ++i) EXPECT_EQ(seen[i].opacity, 1) << i;
  // The last pose is known at .48 s.
  for (int i = 25; i < 50; ++i) {
    EXPECT_NEAR(seen[i].opacity, std::max(0., 1 - (.02 * i - .48) / .25), 1e-6) << i;
    EXPECT_EQ(seen[i].world_from_camera, seen[24].world_from_camera);
  }
  EXPECT_EQ(seen[37].opacity, 0);
  for (int i = 50; i < 55; ++i) EXPECT_NEAR(seen[i].opacity, .2 * (i - 49), 1e-6) << i;
  for (int i = 55; i < 80; ++i) EXPECT_EQ(seen[i].opacity, 1) << i;
}

TEST(PosedSource, FadesNoFasterForAPoseThatFlickers) {
  Made m = make();
  for (int i = 0; i < 40; ++i) m.poses->away.emplace_back(.2 + .04 * i, .219 + .04 * i);
  double before = 1;
  for (int i = 0; i < 60; ++i) m.frames->add(kView, .02 * i);
  for (int i = 0; i < 60; ++i) {
    const Frame frame = **m.posed->next();
    EXPECT_GE(frame.opacity, before - .0801) << i;  // 20 ms of 250
    EXPECT_GE(frame.opacity, .9) << i;
    before = frame.opacity;
  }
}

TEST(PosedSource, NothingVirtualShowsBeforeTheFirstPose) {
  Made m = make();
  m.poses->away = {{-1, .1}};
  for (int i = 0; i < 12; ++i) m.frames->add(kView, .02 * i);
  for (int i = 0; i < 5; ++i) EXPECT_EQ((**m.posed->next()).opacity, 0) << i;
  for (int i = 5; i < 10; ++i) EXPECT_NEAR((**m.posed->next()).opacity, .2 * (i - 4), 1e-6) << i;
}

TEST(PosedSource, SurroundingsWithoutAPoseAreLeftOutAndCounted) {
  Made m = make();
  m.poses->away = {{.1, .2}};
  for (const double t : {.05, .1, .15, .19, .25}) m.frames->add(kSurroundings, t);
  m.frames->add(kFixed, .15);
  EXPECT_EQ((**m.posed->next()).time, after(.05));
  EXPECT_EQ((**m.posed->next()).time, after(.25));
  EXPECT_EQ(m.posed->left_out(), 3u);
  EXPECT_EQ((**m.posed->next()).camera, kFixed);
}

TEST(PosedSource, HandsOnWhatItsSourceIsAsked) {
  Made m = make();
  EXPECT_EQ(m.posed->cameras().size(), 3u);
  EXPECT_EQ(m.posed->view_rate(), 59.94);
  EXPECT_TRUE(m.posed->is_live());
  EXPECT_EQ(m.posed->counts().size(), 3u);
  EXPECT_TRUE(m.posed->take_darker(kView, .25));
  EXPECT_EQ(m.frames->darker, std::pair(kView, .25));
  m.posed->close();
  EXPECT_TRUE(m.frames->closed);
  EXPECT_EQ(m.posed->pose_state().name, "fake");
}

TEST(PosedSource, RefusesCamerasThatAreNotThere) {
  const auto why = [](PosedSourceOptions options) {
    const auto made = PosedSource::create(std::make_unique<FakeSource>(),
                                          std::make_unique<FakePoses>(), std::move(options));
    return made ? std::string() : made.error().detail;
  };
  EXPECT_EQ(why({{{0, {}}}, Seconds(0)}), "");
  EXPECT_THAT(why({}), HasSubstr("no camera that moves"));
  EXPECT_THAT(why({{{3, {}}}, Seconds(0)}), HasSubstr("no camera 3"));
  EXPECT_THAT(why({{{-1, {}}}, Seconds(0)}), HasSubstr("no camera -1"));
  EXPECT_THAT(why({{{1, {}}, {1, {}}}, Seconds(0)}), HasSubstr("surroundings is named twice"));
  EXPECT_THAT(why({{{0, Pose{{1, 0, 0, 0}, {NAN, 0, 0}}}}, Seconds(0)}), HasSubstr("not finite"));
  EXPECT_THAT(why({{{0, {}}}, Seconds(NAN)}), HasSubstr("not finite"));
  EXPECT_THAT(why({{{0, {}}}, Seconds(4000)}), HasSubstr("an hour"));
}

constexpr const char* kTracked = R"(version = 1
[rig]
frame = "tracked body"
tracker_offset_s = 0.0375
[[camera]]
name = "surroundings"
world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0.1,0.2,0.3,1]
)";

TEST(PosedSource, TakesItsCamerasFromAPoseFileOfABody) {
  const auto file = calib::parse_pose_file(kTracked, "poses.toml");
  ASSERT_TRUE(file) << file.error().detail;
  EXPECT_EQ(file->tracker_offset, Seconds(.0375));
  const FakeSource source;
  const auto moving = moving_cameras(source.cameras(), *file, "poses.toml");
  ASSERT_TRUE(moving);
  ASSERT_EQ(moving->size(), 1u);
  EXPECT_EQ((*moving)[0].camera, kSurroundings);
  EXPECT_EQ((*moving)[0].body_from_camera.translation, glm::dvec3(.1, .2, .3));
  calib::PoseFile still = *file;
  still.poses_in = calib::PosesIn::kWorld;
  EXPECT_THAT(moving_cameras(source.cameras(), still, "poses.toml").error().detail,
              HasSubstr("in the world"));
  calib::PoseFile others = *file;
  others.cameras[0].name = "other";
  EXPECT_EQ(moving_cameras(source.cameras(), others, "poses.toml").error().code,
            ErrorCode::kNotFound);
}

}  // namespace
}  // namespace penumbra::capture
