#include "compositor/projection.h"

#include <glm/common.hpp>
#include <glm/geometric.hpp>

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

ViewProjection::ViewProjection(const prt::PinholeView& camera, const ViewLens* lens)
    : lens_(lens),
      width_(camera.width),
      height_(camera.height),
      matrix_(lens ? camera.world_from_camera.inverse().matrix() : clip_from_world_of(camera)) {}

ViewProjection ViewProjection::of(const Pose& here_from_points) const {
  ViewProjection out = *this;
  out.matrix_ = matrix_ * here_from_points.matrix();
  return out;
}

namespace {

// Grows with points, and gives whole pixels with one more on each side.
class PointBounds {
 public:
  PointBounds(int width, int height) : width_(width), height_(height), x0_(width), y0_(height) {}
  void add(const glm::dvec2& p) {
    x0_ = std::min(x0_, p.x), x1_ = std::max(x1_, p.x);
    y0_ = std::min(y0_, p.y), y1_ = std::max(y1_, p.y);
  }
  Rect pixels(double margin) const {
    const auto clamped = [](double v, int limit) {
      return static_cast<int>(std::clamp(v, 0., static_cast<double>(limit)));
    };
    const Rect out{clamped(std::floor(x0_ - margin) - 1, width_),
                   clamped(std::floor(y0_ - margin) - 1, height_),
                   clamped(std::ceil(x1_ + margin) + 1, width_),
                   clamped(std::ceil(y1_ + margin) + 1, height_)};
    return out.empty() ? Rect{} : out;
  }

 private:
  int width_, height_;
  double x0_, y0_, x1_ = 0, y1_ = 0;
};

}  // namespace

Rect ViewProjection::reach(std::span<const glm::dvec3> points) const {
  if (lens_) return reach_through_lens(points);
  PointBounds bounds(width_, height_);
  int behind = 0;
  for (const glm::dvec3& p : points) {
    const glm::dvec4 c = matrix_ * glm::dvec4(p, 1);
    if (c.w < kNearPlane)
      ++behind;
    else
      bounds.add({(c.x / c.w + 1) / 2 * width_, (c.y / c.w + 1) / 2 * height_});
  }
  if (behind == static_cast<int>(points.size())) return {};
  if (behind > 0) return {0, 0, width_, height_};
  return bounds.pixels(0);
}

std::optional<ViewProjection::Angles> ViewProjection::angles_of(
    std::span<const glm::dvec3> points) const {
  glm::dvec3 centre(0);
  for (const glm::dvec3& p : points) centre += p;
  centre /= double(points.size());
  double radius = 0;  // rigid: the same in the camera's frame
  for (const glm::dvec3& p : points) radius = std::max(radius, glm::distance(p, centre));
  const glm::dvec3 there(matrix_ * glm::dvec4(centre, 1));
  const double distance = glm::length(there);
  if (radius >= distance) return std::nullopt;
  const double off = std::atan2(std::hypot(there.x, there.y), -there.z),
               half = std::asin(radius / distance);
  return Angles{off - half, off + half};
}

bool ViewProjection::may_cut(std::span<const glm::dvec3> points) const {
  if (!lens_) return true;
  const auto angles = angles_of(points);
  return !angles || angles->largest > lens_->max_angle_rad();
}

// What a face shows is bounded by its edges, which bend.
Rect ViewProjection::reach_through_lens(std::span<const glm::dvec3> points) const {
  constexpr int kPieces = 12;  // of an edge
  const auto in_camera = [&](const glm::dvec3& p) {
    return glm::dvec3(matrix_ * glm::dvec4(p, 1));
  };
  glm::dvec3 corners[8];
  const std::size_t count = std::min<std::size_t>(points.size(), 8);
  for (std::size_t i = 0; i < count; ++i) corners[i] = in_camera(points[i]);
  const auto angles = angles_of(points);
  if (angles && angles->least > lens_->max_angle_rad()) return {};
  const Rect all{0, 0, width_, height_};
  PointBounds bounds(width_, height_);
  double longest = 0;
  for (std::size_t a = 0; a < count; ++a)
    for (std::size_t bit = 1; bit < count; bit *= 2) {
      if (a & bit) continue;
      glm::dvec2 before(0);
      for (int k = 0; k <= kPieces; ++k) {
        const glm::dvec3 p = glm::mix(corners[a], corners[a | bit], double(k) / kPieces);
        if (lens_->is_beside(p) || glm::length(p) < kNearPlane) return all;
        const glm::dvec2 at = lens_->pixel(p);
        if (k > 0) longest = std::max(longest, glm::distance(at, before));
        bounds.add(before = at);
      }
    }
  // Between two positions an edge bends out by a part of their distance.
  const double focal = std::min(lens_->model().focal_px.x, lens_->model().focal_px.y);
  return bounds.pixels(std::min(longest, longest * longest / (4 * focal)));
}

}  // namespace penumbra::compositor
