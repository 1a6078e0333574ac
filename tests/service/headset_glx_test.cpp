// Runtimes that take pictures from GLX, as none that Debian has.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <string>
#include <vector>

#include "tests/support/headset_fixture.h"
#include "tests/support/x_display.h"

namespace penumbra::service {
namespace {

class HeadsetOverGlx : public HeadsetOutput {
 protected:
  // What a session shows of one picture, from the bottom row of the left eye.
  std::vector<std::uint8_t> picture_shown() {
    (void)FakeHeadset::frames();
    EXPECT_TRUE(shows(3));
    for (const FakeOpenXrFrame& frame : FakeHeadset::frames())
      if (!frame.views.empty() && !frame.views[0].rgba.empty()) return frame.views[0].rgba;
    return {};
  }
};

TEST_F(HeadsetOverGlx, ShowsWhatItShowsOverEgl) {
  const test::XDisplay display;
  if (!display.is_there()) GTEST_SKIP() << "Xvfb is not installed";
  fake_.turn("KEEP", "1");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  const auto over_egl = picture_shown();
  headset_.reset();
  fake_.turn("REFUSE", "egl");
  const auto over_glx = start();
  ASSERT_TRUE(over_glx) << over_glx.error().detail;
  ASSERT_TRUE(runs()) << headset_->state().trouble;
  EXPECT_NE(std::string(FakeHeadset::state().extensions).find("XR_KHR_opengl_enable"),
            std::string::npos);
  const auto shown = picture_shown();
  ASSERT_EQ(shown.size(), over_egl.size());
  ASSERT_FALSE(shown.empty());
  int most = 0;
  for (std::size_t i = 0; i < shown.size(); ++i)
    most = std::max(most, std::abs(int(shown[i]) - int(over_egl[i])));
  EXPECT_LE(most, 1) << "codes: sRGB is written alike";
  EXPECT_GT(*std::ranges::max_element(shown), 150) << "something is shown";
}

TEST_F(HeadsetOverGlx, WithoutADisplayItSaysSo) {
  fake_.turn("REFUSE", "egl");
  const char* const before = std::getenv("DISPLAY");
  const std::string kept = before ? before : "";
  ::unsetenv("DISPLAY");
  const auto refused = start();
  if (before) ::setenv("DISPLAY", kept.c_str(), 1);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().detail.find("is DISPLAY set?"), std::string::npos)
      << refused.error().detail;
}

// Xlib's own answer is to end the program.
TEST_F(HeadsetOverGlx, AServerThatGoesEndsNothing) {
  test::XDisplay display;
  if (!display.is_there()) GTEST_SKIP() << "Xvfb is not installed";
  fake_.turn("REFUSE", "egl");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(2));
  display.end();
  (void)shows(5, .5);
  headset_.reset();
}

// The runtime that comes back takes other graphics than the one that went.
TEST_F(HeadsetOverGlx, AnotherRuntimeGetsTheGraphicsThatItTakes) {
  const test::XDisplay display;
  if (!display.is_there()) GTEST_SKIP() << "Xvfb is not installed";
  fake_.turn("LOSE_AFTER", "20");
  PENUMBRA_START();
  ASSERT_TRUE(runs());
  EXPECT_TRUE(shows(2));
  fake_.turn("REFUSE", "egl");
  const bool over_glx = within(15, [&] {
    (void)shows(1, .05);
    return std::string(FakeHeadset::state().extensions).find("XR_KHR_opengl_enable") !=
               std::string::npos &&
           headset_->state().phase == HeadsetPhase::kRunning;
  });
  EXPECT_TRUE(over_glx) << headset_->state().trouble;
  EXPECT_TRUE(shows(2));
}

}  // namespace
}  // namespace penumbra::service
