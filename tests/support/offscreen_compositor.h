// A compositor of the tests' scenes that shows nothing.
#pragma once

#include <gtest/gtest.h>

#include <memory>

#include "compositor/composite/compositor.h"
#include "tests/support/scenes.h"

namespace penumbra::test {

class OffscreenCompositor : public testing::Test {
 protected:
  using Compositor = compositor::Compositor;
  void SetUp() override {
    auto made = Compositor::create(kSceneWidth, kSceneHeight, Compositor::Surface::kOffscreen);
    if (!made && made.error().code == ErrorCode::kUnavailable)
      GTEST_SKIP() << "no OpenGL ES 3.1: " << made.error().detail;
    ASSERT_TRUE(made) << made.error().detail;
    compositor_ = std::move(*made);
  }
  std::unique_ptr<Compositor> compositor_;
};

}  // namespace penumbra::test
