// Frames of other times, played as if cameras took them now.
#include "service/played_source.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

namespace penumbra::service {
namespace {

std::int64_t now() {
  return std::chrono::steady_clock::now().time_since_epoch().count();
}

class FramesFromZero : public capture::FrameSource {
 public:
  explicit FramesFromZero(std::chrono::milliseconds takes = {}) : takes_(takes) {}
  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return 25; }
  Result<std::optional<capture::Frame>> next() override {
    if (next_ == 6) return std::nullopt;
    std::this_thread::sleep_for(takes_);
    capture::Frame out;
    out.time.value = 7 + 40'000'000 * next_++;
    return out;
  }
  bool take_darker(int, double factor) override {
    darker = factor;
    return true;
  }
  double darker = 0;

 private:
  std::vector<capture::CameraInfo> cameras_{1};
  std::int64_t next_ = 0;
  std::chrono::milliseconds takes_;
};

TEST(PlayedSource, FramesHaveTheTimesAtWhichTheyAreDue) {
  PlayedSource played(std::make_unique<FramesFromZero>());
  const std::int64_t before = now();
  const auto first = *played.next();
  ASSERT_TRUE(first);
  EXPECT_GE(first->time.value, before);
  EXPECT_LE(first->time.value, now());
  for (int i = 1; i < 6; ++i) {
    const auto frame = *played.next();
    ASSERT_TRUE(frame);
    EXPECT_GE(now(), frame->time.value) << "a frame is there when its time has come";
    const std::int64_t since = frame->time.value - first->time.value;
    if (now() - frame->time.value < 200'000'000) {  // else the machine was too busy
      EXPECT_EQ(since, 40'000'000 * i);
    }
  }
  const auto end = played.next();
  ASSERT_TRUE(end);
  EXPECT_FALSE(*end);
  EXPECT_TRUE(played.is_live());
}

TEST(PlayedSource, ASourceThatIsTooSlowDoesNotFallBehindForGood) {
  PlayedSource played(std::make_unique<FramesFromZero>(std::chrono::milliseconds(150)));
  for (int i = 0; i < 6; ++i) {
    const auto frame = *played.next();
    ASSERT_TRUE(frame);
    EXPECT_LE(now() - frame->time.value, 260'000'000) << i;
    if (i == 5) {
      EXPECT_GE(now() - frame->time.value, 0);
    }
  }
}

TEST(PlayedSource, AWaitEndsWhenItIsClosed) {
  PlayedSource played(std::make_unique<FramesFromZero>());
  ASSERT_TRUE(*played.next());
  played.close();
  const auto frame = played.next();
  ASSERT_TRUE(frame);
  EXPECT_FALSE(*frame);
}

TEST(PlayedSource, ItsCamerasAreThoseOfTheSource) {
  auto frames = std::make_unique<FramesFromZero>();
  FramesFromZero& source = *frames;
  PlayedSource played(std::move(frames));
  EXPECT_EQ(played.cameras().size(), 1u);
  EXPECT_EQ(played.view_rate(), 25);
  EXPECT_TRUE(played.take_darker(0, .5));
  EXPECT_EQ(source.darker, .5);
}

}  // namespace
}  // namespace penumbra::service
