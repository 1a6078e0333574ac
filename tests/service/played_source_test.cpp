// Frames of other times, played as if cameras took them now.
#include "service/played_source.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

namespace penumbra::service {
namespace {

class FramesFromZero : public capture::FrameSource {
 public:
  const std::vector<capture::CameraInfo>& cameras() const override { return cameras_; }
  double view_rate() const override { return 25; }
  Result<std::optional<capture::Frame>> next() override {
    if (next_ == 4) return std::nullopt;
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
};

TEST(PlayedSource, FramesHaveTheTimesAtWhichTheyAreDue) {
  const auto now = [] { return std::chrono::steady_clock::now().time_since_epoch().count(); };
  PlayedSource played(std::make_unique<FramesFromZero>());
  const std::int64_t before = now();
  const auto first = *played.next();
  ASSERT_TRUE(first);
  EXPECT_GE(first->time.value, before);
  EXPECT_LE(first->time.value, now());
  for (int i = 1; i < 4; ++i) {
    const auto frame = *played.next();
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->time.value - first->time.value, 40'000'000 * i);
  }
  const auto end = played.next();
  ASSERT_TRUE(end);
  EXPECT_FALSE(*end);
  EXPECT_FALSE(played.is_live()) << "a live run waits for each frame's time";
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
