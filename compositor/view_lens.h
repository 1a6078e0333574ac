// A lens that is no pinhole: where it puts points in the picture, and where its pixels look.
// threads: const members reentrant
#pragma once

#include <cstddef>
#include <glm/mat4x4.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "calib/camera/camera_model.h"
#include "core/result.h"

namespace penumbra::compositor {

/// Points go by a table of the picture's radius over the angle from the axis, and by the decentring
/// of Brown 1966. Beyond what the formula covers the radius grows on, so that every point has a
/// place beside the picture. Pixels go by rays at the nodes of a grid, between which they are
/// linear: .01 px off at most with a focal length of 300 px or more.
/// source: camera_model.h
class ViewLens {
 public:
  /// A pinhole without distortion is none: null.
  /// errors: kInvalid (a map of the whole sphere, a picture that folds back on itself), `where` is
  /// given
  static Result<std::shared_ptr<const ViewLens>> create(const calib::CameraModel& model,
                                                        const std::string& where);

  const calib::CameraModel& model() const { return model_; }

  /// Of a point in the camera's frame.
  glm::dvec2 pixel(const glm::dvec3& in_camera) const;
  /// Of many points, in single precision: pixel and 1/distance, which is negative where is_beside
  /// holds.
  void project(std::span<const glm::vec3> points, const glm::dmat4& camera_from_points,
               std::span<glm::vec3> out) const;
  /// Whether a point lies further off the axis than anything that the picture shows.
  bool is_beside(const glm::dvec3& in_camera) const;
  /// The angle from the axis beyond which is_beside holds, radians.
  double max_angle_rad() const { return max_angle_rad_; }

  /// The radius over the angle from the axis, for a focal length of 1, at i/kSteps of the measure u
  /// of that angle. u = t/(1 + t) with t = tan(angle/2), which takes no more than lengths:
  /// u = side/(side + |p| - z) of a point at the distance `side` from the axis.
  static constexpr int kSteps = 2047;
  const std::vector<float>& radius() const { return radius_; }
  /// The decentring p1, p2, and the largest tangent of an angle that it is taken for.
  glm::dvec2 decentring() const { return decentring_; }
  double max_tangent() const { return max_tangent_; }

  /// Rays in the camera's frame, of any length, at the positions (kCell i, kCell j) of the picture;
  /// 0 where it shows nothing. Rows of columns() nodes, with room to read kPadding beyond the last.
  static constexpr std::size_t kPadding = 64;
  static constexpr int kCell = 4;  // pixels
  std::size_t columns() const { return columns_; }
  const float* ray_x() const { return x_.data(); }
  const float* ray_y() const { return y_.data(); }
  const float* ray_z() const { return z_.data(); }

  /// The longest edge of a triangle, metres, that stays straight to a tenth of a pixel before this
  /// lens, .7 m away or further.
  double max_edge_m() const { return max_edge_m_; }

 private:
  ViewLens() = default;
  Result<void> make_rays(const std::string& where);
  void make_radius();
  void find_max_edge();
  template <class Number>
  glm::vec<2, Number> place(const glm::vec<3, Number>& p, Number distance) const;

  calib::CameraModel model_;
  std::vector<float> radius_;
  glm::dvec2 decentring_{0, 0};
  double max_tangent_ = 0, max_angle_rad_ = 0, max_edge_m_ = 0;
  std::size_t columns_ = 0;
  std::vector<float> x_, y_, z_;
};

}  // namespace penumbra::compositor
