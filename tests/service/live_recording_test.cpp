#include "service/recording/live_recording.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <random>
#include <thread>

#include "tests/support/temp_folder.h"

namespace penumbra::service {
namespace {

// One camera that sends as many frames as it is told to.
class DrivenCamera : public capture::FrameSource {
 public:
  DrivenCamera() {
    cameras_[0].name = "view";
    cameras_[0].role = capture::Role::kView;
    cameras_[0].projection.width = kWidth, cameras_[0].projection.height = kHeight;
  }
  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  Result<std::optional<capture::Frame>> next() override {
    capture::Frame out;
    out.time = TimestampNs{++sent_ * 33'000'000};
    Image<Rgb8> noise(kWidth, kHeight);  // which no codec makes small
    for (Rgb8& p : noise.pixels()) {
      p.r = static_cast<std::uint8_t>(random_());
      p.g = static_cast<std::uint8_t>(random_());
      p.b = static_cast<std::uint8_t>(random_());
    }
    out.pixels = std::make_shared<const FramePixels>(std::move(noise));
    return out;
  }
  double view_rate() const override { return 30; }
  bool is_live() const override { return true; }
  void close() override {}
  std::vector<capture::CameraCounts> counts() const override { return {{}}; }

 private:
  static constexpr int kWidth = 128, kHeight = 64;
  std::mt19937 random_{3};
  std::vector<capture::CameraInfo> cameras_{1};
  std::int64_t sent_ = 0;
};

TEST(LiveRecording, OneThatIsStoppedBeforeItsFirstFrameSaysThatNothingIsKept) {
  const test::TempFolder folder;
  DrivenCamera camera;
  LiveRecording recording(folder.path());
  const auto tap = recording.tap(camera);
  ASSERT_TRUE(recording.start("a.mkv"));
  const auto stopped = recording.stop();
  ASSERT_TRUE(stopped) << stopped.error().detail;
  EXPECT_NE(stopped->error.find("nothing is kept"), std::string::npos) << stopped->error;
  EXPECT_FALSE(stopped->active);
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "a.mkv"));
}

// What it had written is told, not what it told a second before.
TEST(LiveRecording, OneThatCannotGoOnTellsAllThatItKept) {
  const test::TempFolder folder;
  DrivenCamera camera;
  LiveRecording recording(folder.path());
  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{1 << 20, before.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &small);
  {
    const auto tap = recording.tap(camera);
    ASSERT_TRUE(recording.start("a.mkv"));
    for (int i = 0; i < 2000 && recording.state()->active; ++i) {
      ASSERT_TRUE(tap->next());
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
  }
  ::setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  const auto state = recording.state();
  ASSERT_TRUE(state);
  EXPECT_FALSE(state->active);
  ASSERT_EQ(state->counts.frames.size(), 1u) << state->error;
  EXPECT_NE(state->error.find(fmt::format("the first {} frames are kept", state->counts.frames[0])),
            std::string::npos)
      << state->error;
}

}  // namespace
}  // namespace penumbra::service
