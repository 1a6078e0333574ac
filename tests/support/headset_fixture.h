// Test support: a headset output over the fake runtime, and pictures for it.
// threads: thread-bound
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <glm/gtc/quaternion.hpp>
#include <memory>
#include <thread>
#include <utility>

#include "service/headset/headset.h"
#include "tests/support/fake_headset.h"
#include "tests/support/gl.h"

namespace penumbra::service {

using test::FakeHeadset;
using test::within;

inline TimestampNs now_ns() {
  return {std::chrono::steady_clock::now().time_since_epoch().count()};  // CLOCK_MONOTONIC
}

inline Pose true_head(TimestampNs time, double turn_deg_s) {
  return {glm::angleAxis(fake_openxr_yaw(turn_deg_s, time.value), glm::dvec3(0, 1, 0)),
          {0, kFakeOpenXrEyeHeight_m, 0}};
}

inline EyePicture plain_picture(Rgb8 colour, TimestampNs captured) {
  auto camera = *calib::make_projection(calib::ProjectionKind::kPinhole, 64, 48);
  return {std::make_shared<FramePixels>(Image<Rgb8>(64, 48, colour)),
          camera,
          {{1, 0, 0, 0}, {0, kFakeOpenXrEyeHeight_m, 0}},
          captured,
          {},
          {}};
}

class HeadsetOutput : public testing::Test {
 protected:
  ~HeadsetOutput() override {
    headset_.reset();
    EXPECT_EQ(FakeHeadset::faults(), "") << "what the runtime was asked wrongly";
    EXPECT_EQ(FakeHeadset::state().instances, 0);
  }
  Result<void> start(const HeadsetOptions& options = {}) {
    PENUMBRA_ASSIGN(made, Headset::create(options));
    headset_ = std::move(made);
    return {};
  }
  bool runs(double seconds = 5) {
    return within(seconds, [&] { return headset_->state().phase == HeadsetPhase::kRunning; });
  }
  // Shows pictures at 54 Hz until it has shown so many more.
  bool shows(std::uint64_t count, double seconds = 5) {
    const std::uint64_t before = headset_->state().shown;
    return within(seconds, [&] {
      headset_->show(-1, plain_picture({200, 100, 50}, now_ns() + Seconds(-.005)));
      std::this_thread::sleep_for(std::chrono::milliseconds(13));
      return headset_->state().shown >= before + count;
    });
  }

  FakeHeadset fake_;
  std::unique_ptr<Headset> headset_;
};

#define PENUMBRA_START(...)                \
  const auto started = start(__VA_ARGS__); \
  PENUMBRA_NEED_GL(started);               \
  ASSERT_TRUE(started) << started.error().where << ": " << started.error().detail

}  // namespace penumbra::service
