// Real things that no scene knows, in one view's picture: hands, people, a cup.
// threads: plain values
#pragma once

#include <algorithm>
#include <cstddef>
#include <glm/vec4.hpp>
#include <vector>

#include "compositor/projection.h"

namespace penumbra::compositor {

/// What is drawn is hidden by them where it lies farther away, and shadows of what is drawn do not
/// fall on them.
struct Foreground {
  /// How much farther something must lie to be behind a thing at a distance: what a thing touches
  /// stays whole though distances are noisy. Metres.
  static constexpr float kMinMargin_m = .015f, kMargin = .02f;
  static float margin_m(float distance_m) { return std::max(kMinMargin_m, kMargin * distance_m); }

  /// Of a pixel that nothing covers: farther than anything that is drawn.
  static constexpr float kNowhere_m = 1e6f;

  Rect area;  // elsewhere nothing is in front
  /// By pixel of the area, row by row: metres along the axis of a pinhole, from the eye through a
  /// lens.
  std::vector<float> distance_m;
  /// a: the fraction of the pixel that the thing covers, 0..1. r, g, b: where the pixel's
  /// background is replaced, what its camera pixel then has too little of the thing and too much of
  /// that background, c (1 - c) (F - B) in signal.
  std::vector<glm::vec4> cover;

  std::size_t index(int x, int y) const {
    return static_cast<std::size_t>(y - area.y0) * static_cast<std::size_t>(area.width()) +
           static_cast<std::size_t>(x - area.x0);
  }
};

}  // namespace penumbra::compositor
