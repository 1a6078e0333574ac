// From the world to the picture: clip coordinates and the pixels that something can reach.
// threads: plain values
#pragma once

#include <algorithm>
#include <cmath>
#include <glm/mat4x4.hpp>
#include <optional>
#include <span>

#include "compositor/view_lens.h"
#include "core/pose.h"
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

/// How a view puts points of some frame, the world's at first, into its picture.
class ViewProjection {
 public:
  /// lens: null for a pinhole; outlives this
  ViewProjection(const prt::PinholeView& camera, const ViewLens* lens);
  /// The same for points of another frame.
  ViewProjection of(const Pose& here_from_points) const;

  const ViewLens* lens() const { return lens_; }
  /// Without a lens into clip coordinates, with one into the camera's frame.
  const glm::dmat4& matrix() const { return matrix_; }
  int width() const { return width_; }
  int height() const { return height_; }

  /// Pixels that the convex hull of the points can reach; the whole frame when it reaches behind
  /// the camera, or out of what a lens shows.
  /// points: corners of a rectangle (4) or a box (8), each next to those whose number differs in
  /// one bit
  Rect reach(std::span<const glm::dvec3> points) const;
  /// Whether a lens may show the hull of the points in part only, or there is no lens.
  bool may_cut(std::span<const glm::dvec3> points) const;

 private:
  Rect reach_through_lens(std::span<const glm::dvec3> points) const;
  // Angles from the axis, radians, between which the hull lies; nothing when it is around the eye
  struct Angles {
    double least, largest;
  };
  std::optional<Angles> angles_of(std::span<const glm::dvec3> points) const;

  const ViewLens* lens_;
  int width_, height_;
  glm::dmat4 matrix_;
};

}  // namespace penumbra::compositor
