// Camera models: where each pixel looks.
// Camera frame: looks along -z, +y up in the picture, +x right (conventions.h).
// threads: every function is reentrant; all types are plain values
#pragma once

#include <algorithm>
#include <array>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <string_view>

#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

enum class ProjectionKind {
  kLatLong,  // whole sphere, conventions.h
  kAngular,  // whole sphere, radius proportional to the angle from -z; inscribed circle (Debevec)
  kMirrorBall,   // orthographic mirror ball, r = R sin(th/2); inscribed circle; exactly equal area
  kEquidistant,  // fisheye r = f th
  // Fisheye r = f (th + k1 th^3 + k2 th^5 + k3 th^7 + k4 th^9); Kannala & Brandt 2006
  kKannalaBrandt,
  kDoubleSphere,   // fisheye of parameters xi, alpha; Usenko, Demmel & Cremers 2018
  kPinhole,        // with k1, k2, p1, p2, k3 of Brown 1966, if any
  kVerticalCross,  // 3 x 4 faces: top; left front right; bottom; back turned by 180 degrees
  kExrLatLong,     // OpenEXR's lat-long: centre +z, +x left of centre, pixel centres on the poles
  kExrCube,        // OpenEXR's cube: +X -X +Y -Y +Z -Z stacked, pixel centres on the face edges
};

/// Names as in files and options: latlong, angular, mirror-ball, equidistant, kb4, double-sphere,
/// pinhole, vertical-cross, exr-latlong, exr-cube.
/// errors: kInvalid naming the known ones
Result<ProjectionKind> projection_kind(std::string_view name);
std::string_view projection_name(ProjectionKind kind);

/// How many numbers `distortion` has: kb4 k1..k4, double-sphere xi, alpha; pinhole k1 k2 p1 p2 k3,
/// in the order and meaning of OpenCV.
int distortion_count(ProjectionKind kind);
/// Whether the kind has focal_px and principal_px.
bool has_intrinsics(ProjectionKind kind);

/// Kind, size and, for lenses, the intrinsics in continuous pixels.
struct CameraModel {
  ProjectionKind kind = ProjectionKind::kLatLong;
  int width = 0, height = 0;
  glm::dvec2 focal_px{0, 0};
  glm::dvec2 principal_px{0, 0};
  std::array<double, 5> distortion{};  // distortion_count(kind) of them are used
  bool operator==(const CameraModel&) const = default;
  [[nodiscard]] bool is_distorted() const {
    return std::ranges::any_of(distortion, [](double k) { return k != 0; });
  }
};

/// A camera model with defaults filled in: principal point in the middle; fisheyes: 180 degrees
/// across the shorter side, undistorted; pinhole: 60 degrees across the height.
/// errors: kInvalid (size, aspect of a cross)
Result<CameraModel> make_projection(ProjectionKind kind, int width, int height);

/// Direction in the camera frame seen at a continuous pixel; nothing outside the picture's valid
/// area.
std::optional<glm::dvec3> direction_from_pixel(const CameraModel& projection, glm::dvec2 pixel);

/// Sets the distortion; missing numbers at the end are 0, and zeros too many do no harm.
/// errors: kInvalid (too many, not finite, xi not within -1..1 or alpha not within 0..1, a lens
/// whose picture folds back before 30 degrees off the axis)
Result<CameraModel> with_distortion(CameraModel projection, std::span<const double> distortion);

/// Inverse; nothing where the camera does not look (behind a pinhole, outside a fisheye's picture).
std::optional<glm::dvec2> pixel_from_direction(const CameraModel& projection,
                                               const glm::dvec3& direction);
/// The same also beside the picture, as far as the lens's formula holds. Only for kinds with
/// intrinsics.
std::optional<glm::dvec2> pixel_of_lens(const CameraModel& lens, const glm::dvec3& direction);

}  // namespace penumbra::calib
#pragma GCC visibility pop
