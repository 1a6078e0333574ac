#include "compositor/projection.h"

namespace penumbra::compositor {

glm::dmat4 clip_from_world_of(const prt::PinholeView& v) {
  glm::dmat4 m(0);
  m[0][0] = 2 * v.focal_px.x / v.width;
  m[2][0] = 1 - 2 * v.principal_px.x / v.width;
  m[1][1] = -2 * v.focal_px.y / v.height;
  m[2][1] = 1 - 2 * v.principal_px.y / v.height;
  m[2][2] = (kFarPlane + kNearPlane) / (kNearPlane - kFarPlane);
  m[3][2] = 2 * kFarPlane * kNearPlane / (kNearPlane - kFarPlane);
  m[2][3] = -1;
  return m * v.world_from_camera.inverse().matrix();
}

Rect reach(const glm::dmat4& clip_from_points, std::span<const glm::dvec3> points, int width,
           int height) {
  double x0 = width, y0 = height, x1 = 0, y1 = 0;
  int behind = 0;
  for (const glm::dvec3& p : points) {
    const glm::dvec4 c = clip_from_points * glm::dvec4(p, 1);
    if (c.w < kNearPlane) {
      ++behind;
      continue;
    }
    const double x = (c.x / c.w + 1) / 2 * width, y = (c.y / c.w + 1) / 2 * height;
    x0 = std::min(x0, x), x1 = std::max(x1, x), y0 = std::min(y0, y), y1 = std::max(y1, y);
  }
  if (behind == static_cast<int>(points.size())) return {};
  if (behind > 0) return {0, 0, width, height};
  const auto clamped = [](double v, int limit) {
    return static_cast<int>(std::clamp(v, 0., static_cast<double>(limit)));
  };
  const Rect out{clamped(std::floor(x0) - 1, width), clamped(std::floor(y0) - 1, height),
                 clamped(std::ceil(x1) + 1, width), clamped(std::ceil(y1) + 1, height)};
  return out.empty() ? Rect{} : out;
}

}  // namespace penumbra::compositor
