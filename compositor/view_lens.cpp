#include "compositor/view_lens.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec4.hpp>
#include <limits>

#include "core/conventions.h"

namespace penumbra::compositor {

namespace {

double angle_of_step(int i) {
  const double u = double(i) / ViewLens::kSteps;
  return 2 * std::atan2(u, 1 - u);
}

double angle_of(const glm::dvec3& p) {
  return std::atan2(std::hypot(p.x, p.y), -p.z);
}

}  // namespace

Result<std::shared_ptr<const ViewLens>> ViewLens::create(const calib::CameraModel& model,
                                                         const std::string& where) {
  if (!calib::has_intrinsics(model.kind))
    return fail(ErrorCode::kInvalid, where,
                fmt::format("is a {} map, and objects are drawn through a lens only",
                            calib::projection_name(model.kind)));
  if (model.kind == calib::ProjectionKind::kPinhole && !model.is_distorted())
    return std::shared_ptr<const ViewLens>();
  std::shared_ptr<ViewLens> out(new ViewLens);
  out->model_ = model;
  PENUMBRA_TRY(out->make_rays(where));
  out->make_radius();
  out->find_max_edge();
  return out;
}

// Along one direction from the axis, without what depends on that direction. From the last angle on
// that the formula covers the radius grows by the angle.
void ViewLens::make_radius() {
  calib::CameraModel radial = model_;
  radial.focal_px = {1, 1};
  radial.principal_px = {0, 0};
  if (model_.kind == calib::ProjectionKind::kPinhole) {
    decentring_ = {model_.distortion[2], model_.distortion[3]};
    radial.distortion[2] = radial.distortion[3] = 0;
  }
  radius_.resize(kSteps + 1);
  double last = 0, last_angle = 0;
  bool covered = true;
  for (int i = 0; i <= kSteps; ++i) {
    const double angle = angle_of_step(i);
    const auto at = calib::pixel_of_lens(radial, {std::sin(angle), 0, -std::cos(angle)});
    covered = covered && at && at->x >= last && at->x < 1e4;
    last = covered ? at->x : last + angle - last_angle;
    last_angle = angle;
    radius_[static_cast<std::size_t>(i)] = static_cast<float>(last);
    if (covered && angle < kPi / 2) max_tangent_ = std::tan(angle);
  }
}

// Pinholes fold back where a corner of the picture has no ray; a fisheye's picture ends there, but
// none ends so near its axis, and within the picture, that a wrong term alone explains it.
Result<void> ViewLens::make_rays(const std::string& where) {
  const auto [width, height] = std::pair(model_.width, model_.height);
  const auto nodes = [](int pixels) { return static_cast<std::size_t>(pixels / kCell) + 2; };
  columns_ = nodes(width);
  const std::size_t rows = nodes(height);
  for (auto* v : {&x_, &y_, &z_}) v->assign(columns_ * rows + kPadding, 0);
  double max_angle = 0;
  const glm::dvec2 axis = model_.principal_px;
  const double border = std::min({axis.x, width - axis.x, axis.y, height - axis.y});
  double end_px = std::numeric_limits<double>::infinity();  // nearest to the axis
  for (std::size_t j = 0; j < rows; ++j)
    for (std::size_t i = 0; i < columns_; ++i) {
      const glm::dvec2 at(double(i) * kCell, double(j) * kCell);
      // The last nodes lie beside the picture: on from those within it.
      const glm::dvec2 inside(std::min(at.x, double(width)), std::min(at.y, double(height)));
      const auto ray = calib::direction_from_pixel(model_, inside);
      if (!ray && model_.kind == calib::ProjectionKind::kPinhole)
        return fail(ErrorCode::kInvalid, where,
                    fmt::format("has a distortion whose picture folds back on itself at pixel "
                                "{:.0f}, {:.0f}",
                                inside.x, inside.y));
      if (!ray) end_px = std::min(end_px, glm::distance(inside, axis));
      if (!ray) continue;
      max_angle = std::max(max_angle, angle_of(*ray));
      glm::dvec3 there = *ray;
      if (at != inside) {
        const glm::dvec2 before = inside - (at - inside);
        if (const auto back = calib::direction_from_pixel(model_, before)) there += *ray - *back;
      }
      if (model_.kind == calib::ProjectionKind::kPinhole) there /= -there.z;
      const std::size_t n = j * columns_ + i;
      x_[n] = static_cast<float>(there.x);
      y_[n] = static_cast<float>(there.y);
      z_[n] = static_cast<float>(there.z);
    }
  constexpr double kNarrowestFisheye = 70 * kPi / 180;
  constexpr double kWithin = .8;  // of what a circle in the picture would reach
  if (end_px < kWithin * border && max_angle < kNarrowestFisheye)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("has a distortion whose picture folds back on itself {:.0f} degrees "
                            "from the axis, within the picture",
                            max_angle * 180 / kPi));
  constexpr double kBeside_rad = .05;  // room for triangles that the border cuts
  max_angle_rad_ = std::min(kPi, max_angle + kBeside_rad);
  return {};
}

// A straight edge of the angle e is off its chord by e^2/8 times the picture's second derivative
// over the angle, beyond that of a pinhole, which keeps straight lines. Across the radius a line
// bends by what the radius differs from a pinhole's, so both are bounded by the second differences
// of radius over tangent.
void ViewLens::find_max_edge() {
  constexpr double kOff_px = .1, kNearest_m = .7, kMinEdge_m = .004, kWide_rad = 1.2;
  const double focal = std::max(model_.focal_px.x, model_.focal_px.y);
  double bend = glm::length(decentring_) * 6;
  const auto stretch = [&](int k) {
    return radius_[static_cast<std::size_t>(k)] / std::tan(angle_of_step(k));
  };
  constexpr int kApart = 16;  // far enough for single precision
  for (int i = 2 * kApart; angle_of_step(i) < std::min(max_angle_rad_, kWide_rad); ++i) {
    const double slope =
        (stretch(i) - stretch(i - kApart)) / (angle_of_step(i) - angle_of_step(i - kApart));
    bend = std::max(bend, 3 * std::abs(slope));
  }
  const double edge_rad = bend > 0 ? std::sqrt(8 * kOff_px / (bend * focal)) : 1;
  max_edge_m_ = std::max(kMinEdge_m, std::min(edge_rad, 1.) * kNearest_m);
}

template <class Number>
glm::vec<2, Number> ViewLens::place(const glm::vec<3, Number>& p, Number distance) const {
  using InPicture = glm::vec<2, Number>;
  const Number side = std::sqrt(p.x * p.x + p.y * p.y), rest = side + distance - p.z;
  const Number at = (rest > 0 ? side / rest : 1) * Number(kSteps);
  const auto i = std::min(static_cast<int>(at), kSteps - 1);
  const float* const step = radius_.data() + i;
  const Number radius = step[0] + (at - Number(i)) * (step[1] - step[0]);
  const InPicture along = side > 0 ? InPicture(p.x, -p.y) / side : InPicture(1, 0);
  InPicture q = along * radius;
  if (decentring_ != glm::dvec2(0)) {
    const auto largest = static_cast<Number>(max_tangent_);
    const Number tangent = p.z < 0 ? std::min(side / -p.z, largest) : largest;
    const InPicture u = along * tangent, d(decentring_);
    const Number r2 = tangent * tangent, xy = 2 * u.x * u.y;
    q += InPicture(d.x * xy + d.y * (r2 + 2 * u.x * u.x), d.x * (r2 + 2 * u.y * u.y) + d.y * xy);
  }
  return InPicture(model_.principal_px) + q * InPicture(model_.focal_px);
}

glm::dvec2 ViewLens::pixel(const glm::dvec3& p) const {
  return place(p, glm::length(p));
}

void ViewLens::project(std::span<const glm::vec3> points, const glm::dmat4& camera_from_points,
                       std::span<glm::vec3> out) const {
  const glm::mat4 turn(camera_from_points);
  const auto least = static_cast<float>(std::cos(max_angle_rad_));
  for (std::size_t i = 0; i < points.size(); ++i) {
    const glm::vec3 p(turn * glm::vec4(points[i], 1));
    const float distance = glm::length(p);
    const bool beside = !(-p.z >= least * distance);
    out[i] = {place(p, distance), beside ? -1 : 1 / distance};
  }
}

bool ViewLens::is_beside(const glm::dvec3& p) const {
  return !(-p.z >= std::cos(max_angle_rad_) * glm::length(p));
}

}  // namespace penumbra::compositor
