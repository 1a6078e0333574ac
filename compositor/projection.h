// From the world to the picture: clip coordinates and the pixels that something can reach.
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/mat4x4.hpp>
#include <span>

#include "prt/geometry/pinhole_view.h"

namespace penumbra::compositor {

inline constexpr double kNearPlane = .02, kFarPlane = 1000;  // metres

/// Pixels [x0, x1) x [y0, y1).
struct Rect {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  int width() const { return x1 > x0 ? x1 - x0 : 0; }
  int height() const { return y1 > y0 ? y1 - y0 : 0; }
  bool empty() const { return width() == 0 || height() == 0; }
  friend bool operator==(const Rect&, const Rect&) = default;
};

inline Rect united(const Rect& a, const Rect& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.x0, b.x0), std::min(a.y0, b.y0), std::max(a.x1, b.x1), std::max(a.y1, b.y1)};
}

inline Rect common(const Rect& a, const Rect& b) {
  return {std::max(a.x0, b.x0), std::max(a.y0, b.y0), std::min(a.x1, b.x1), std::min(a.y1, b.y1)};
}
inline bool meet(const Rect& a, const Rect& b) {
  return !a.empty() && !b.empty() && !common(a, b).empty();
}

/// Row 0 of the framebuffer is the top of the picture: clip y grows downwards.
glm::dmat4 clip_from_world_of(const prt::PinholeView& view);

/// Pixels that a convex set of points can reach; the whole frame when the near plane cuts it.
Rect reach(const glm::dmat4& clip_from_points, std::span<const glm::dvec3> points, int width,
           int height);

}  // namespace penumbra::compositor
