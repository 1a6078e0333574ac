#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <utility>

#include "calib/camera/camera_model.h"
#include "calib/camera/internal/radial_lens.h"
#include "core/conventions.h"
#include "core/picture_size.h"

namespace penumbra::calib {
namespace {

constexpr std::array<std::pair<ProjectionKind, std::string_view>, 10> kNames{{
    {ProjectionKind::kLatLong, "latlong"},
    {ProjectionKind::kAngular, "angular"},
    {ProjectionKind::kMirrorBall, "mirror-ball"},
    {ProjectionKind::kEquidistant, "equidistant"},
    {ProjectionKind::kKannalaBrandt, "kb4"},
    {ProjectionKind::kDoubleSphere, "double-sphere"},
    {ProjectionKind::kPinhole, "pinhole"},
    {ProjectionKind::kVerticalCross, "vertical-cross"},
    {ProjectionKind::kExrLatLong, "exr-latlong"},
    {ProjectionKind::kExrCube, "exr-cube"},
}};

// Rounding of a round trip must not push a position on the border out of the picture.
constexpr double kSlackPx = 1e-9;

bool within(double value, double low, double high) {
  return value >= low - kSlackPx && value <= high + kSlackPx;  // false for NaN
}

std::optional<glm::dvec2> clamp_into_picture(const CameraModel& p, glm::dvec2 pixel) {
  if (!within(pixel.x, 0, p.width) || !within(pixel.y, 0, p.height)) return std::nullopt;
  return glm::dvec2{std::clamp(pixel.x, 0., static_cast<double>(p.width)),
                    std::clamp(pixel.y, 0., static_cast<double>(p.height))};
}

// ------------------------------------------------------------------------------- cube faces

/// A face of the unit cube as it lies in the picture: position (a, b) in -1..1, a to the right and
/// b down, sees centre + a right + b down. Column and row count faces.
struct CubeFace {
  glm::dvec3 centre, right, down;
  int column, row;
};

/// Seen from inside. The sides unfold from the front face, so each shares an edge with its
/// neighbour.
constexpr std::array<CubeFace, 6> kCrossFaces{{
    {{0, 1, 0}, {1, 0, 0}, {0, 0, -1}, 1, 0},
    {{-1, 0, 0}, {0, 0, -1}, {0, -1, 0}, 0, 1},
    {{0, 0, -1}, {1, 0, 0}, {0, -1, 0}, 1, 1},
    {{1, 0, 0}, {0, 0, 1}, {0, -1, 0}, 2, 1},
    {{0, -1, 0}, {1, 0, 0}, {0, 0, 1}, 1, 2},
    {{0, 0, 1}, {1, 0, 0}, {0, 1, 0}, 1, 3},
}};

/// The diagram in OpenEXR's ImfEnvmap.h, which numbers the cube's corners.
constexpr std::array<CubeFace, 6> kExrFaces{{
    {{1, 0, 0}, {0, 0, 1}, {0, -1, 0}, 0, 0},
    {{-1, 0, 0}, {0, 0, -1}, {0, -1, 0}, 0, 1},
    {{0, 1, 0}, {1, 0, 0}, {0, 0, -1}, 0, 2},
    {{0, -1, 0}, {1, 0, 0}, {0, 0, 1}, 0, 3},
    {{0, 0, 1}, {-1, 0, 0}, {0, -1, 0}, 0, 4},
    {{0, 0, -1}, {1, 0, 0}, {0, -1, 0}, 0, 5},
}};

/// Where the faces lie: face size in pixels, and how far inside it the directions -1 and +1 are: on
/// the outer pixel borders (cross, inset 0) or on the outer pixel centres (OpenEXR, inset .5).
struct FaceLayout {
  const std::array<CubeFace, 6>& faces;
  double size;
  double inset;
  double span() const { return size - 2 * inset; }
  glm::dvec2 origin(const CubeFace& f) const {
    return {f.column * size + inset, f.row * size + inset};
  }
};

FaceLayout face_layout(const CameraModel& p) {
  if (p.kind == ProjectionKind::kVerticalCross) return {kCrossFaces, p.width / 3., 0};
  return {kExrFaces, static_cast<double>(p.width), .5};
}

std::optional<glm::dvec3> direction_in_faces(const FaceLayout& layout, glm::dvec2 pixel) {
  for (const CubeFace& face : layout.faces) {
    const glm::dvec2 at = pixel - layout.origin(face);
    // Closed on all sides: an edge of the cross that borders on an empty square is still seen.
    if (!within(at.x, 0, layout.span()) || !within(at.y, 0, layout.span())) continue;
    const glm::dvec2 ab = 2. * at / layout.span() - 1.;
    return glm::normalize(face.centre + ab.x * face.right + ab.y * face.down);
  }
  return std::nullopt;
}

glm::dvec2 pixel_in_faces(const FaceLayout& layout, const glm::dvec3& d) {
  const CubeFace& face = *std::max_element(layout.faces.begin(), layout.faces.end(),
                                           [&](const CubeFace& a, const CubeFace& b) {
                                             return glm::dot(a.centre, d) < glm::dot(b.centre, d);
                                           });
  const glm::dvec3 on_face = d / glm::dot(face.centre, d);
  const glm::dvec2 ab{glm::dot(face.right, on_face), glm::dot(face.down, on_face)};
  return layout.origin(face) + (ab + 1.) / 2. * layout.span();
}

// ------------------------------------------------------------------------------- OpenEXR lat-long

// Column 0 has longitude +pi, the last one -pi; row 0 latitude +pi/2, the last one -pi/2; longitude
// turns from +z to +x (ImfEnvmap.h). Positions count from pixel centres there, from borders here.
std::optional<glm::dvec3> direction_in_exr_latlong(const CameraModel& p, glm::dvec2 pixel) {
  const glm::dvec2 last{p.width - 1., p.height - 1.};
  const glm::dvec2 at = pixel - .5;
  if (!within(at.x, 0, last.x) || !within(at.y, 0, last.y)) return std::nullopt;
  const double longitude = 2 * kPi * (.5 - at.x / last.x);
  const double latitude = kPi * (.5 - at.y / last.y);
  return glm::dvec3{std::cos(latitude) * std::sin(longitude), std::sin(latitude),
                    std::cos(latitude) * std::cos(longitude)};
}

glm::dvec2 pixel_in_exr_latlong(const CameraModel& p, const glm::dvec3& d) {
  const double longitude = std::atan2(d.x, d.z);
  const double latitude = std::atan2(d.y, std::hypot(d.x, d.z));
  return {.5 + (p.width - 1) * (.5 - longitude / (2 * kPi)),
          .5 + (p.height - 1) * (.5 - latitude / kPi)};
}

// ------------------------------------------------------------------------------- pinhole

// Brown 1966 in OpenCV's order k1 k2 p1 p2 k3; y down.
glm::dvec2 distort(const std::array<double, 5>& k, const glm::dvec2& q) {
  const double r2 = glm::dot(q, q), xy = q.x * q.y;
  const double radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  return {q.x * radial + 2 * k[2] * xy + k[3] * (r2 + 2 * q.x * q.x),
          q.y * radial + k[2] * (r2 + 2 * q.y * q.y) + 2 * k[3] * xy};
}

// Where the picture folds back on itself: the smallest r^2 at which the slope of the radial part,
// 1 + 3 k1 u + 5 k2 u^2 + 7 k3 u^3 with u = r^2, is no longer positive.
double fold_r2(const std::array<double, 5>& k) {
  const auto slope = [&](double u) { return 1 + u * (3 * k[0] + u * (5 * k[1] + u * 7 * k[4])); };
  // Between its own turning points the slope is monotone: a sign change there is the only one.
  std::array<double, 3> ends{0, 0, 1e4};
  std::array<double, 4> stops{0, 1e4, 1e4, 1e4};
  const double a = 21 * k[4], b = 10 * k[1], c = 3 * k[0], root = b * b - 4 * a * c;
  if (a != 0 && root >= 0) {
    ends = {(-b - std::sqrt(root)) / (2 * a), (-b + std::sqrt(root)) / (2 * a), 1e4};
    std::ranges::sort(ends);
  } else if (a == 0 && b != 0) {
    ends = {0, -c / b, 1e4};
    std::ranges::sort(ends);
  }
  std::size_t n = 1;
  for (const double u : ends)
    if (u > 0 && u <= 1e4) stops[n++] = u;
  for (std::size_t i = 1; i < n; ++i) {
    if (slope(stops[i]) > 0) continue;
    double low = stops[i - 1], high = stops[i];
    for (int j = 0; j < 60; ++j) {
      const double middle = (low + high) / 2;
      (slope(middle) > 0 ? low : high) = middle;
    }
    return low;
  }
  return HUGE_VAL;
}

// The inverse of distort() short of the fold, by Newton's method.
std::optional<glm::dvec2> undistort(const CameraModel& p, const glm::dvec2& q) {
  if (!p.is_distorted()) return q;
  const auto& k = p.distortion;
  const double largest = fold_r2(k);
  constexpr double kInside = .999;
  const auto keep_inside = [&](glm::dvec2 at) {
    const double r2 = glm::dot(at, at);
    return r2 < largest ? at : at * (kInside * std::sqrt(largest / r2));
  };
  glm::dvec2 at = keep_inside(q);
  constexpr int kMaxSteps = 50;
  for (int i = 0; i < kMaxSteps; ++i) {
    const glm::dvec2 off = distort(k, at) - q;
    if (glm::dot(off, off) < 1e-26) break;
    const double r2 = glm::dot(at, at), xy = at.x * at.y;
    const double radial = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
    const double steep = k[0] + r2 * (2 * k[1] + r2 * 3 * k[4]);
    const double xx = radial + 2 * at.x * at.x * steep + 2 * k[2] * at.y + 6 * k[3] * at.x;
    const double yy = radial + 2 * at.y * at.y * steep + 6 * k[2] * at.y + 2 * k[3] * at.x;
    const double mixed = 2 * xy * steep + 2 * k[2] * at.x + 2 * k[3] * at.y;
    const double determinant = xx * yy - mixed * mixed;
    if (determinant == 0) return std::nullopt;
    at = keep_inside(at - glm::dvec2(yy * off.x - mixed * off.y, xx * off.y - mixed * off.x) /
                              determinant);
  }
  const glm::dvec2 left = distort(k, at) - q;
  if (!(glm::dot(left, left) < 1e-16)) return std::nullopt;
  return at;
}

std::optional<glm::dvec2> pinhole_pixel(const CameraModel& p, const glm::dvec3& d) {
  if (d.z >= 0) return std::nullopt;
  glm::dvec2 q = glm::dvec2{d.x, -d.y} / -d.z;
  if (p.is_distorted()) {
    if (glm::dot(q, q) >= fold_r2(p.distortion)) return std::nullopt;
    q = distort(p.distortion, q);
  }
  return p.principal_px + q * p.focal_px;
}

// ------------------------------------------------------------------------------- checks

Result<void> check_shape(ProjectionKind kind, int width, int height) {
  const std::string where(projection_name(kind));
  const std::string size = fmt::format("{}x{}", width, height);
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("the size {} is not within 1..{} pixels", size, kMaxSide));
  if (kind == ProjectionKind::kVerticalCross && width * 4 != height * 3)
    return fail(ErrorCode::kInvalid, where,
                "the size " + size + " is not that of a cross of 3 x 4 squares");
  if (kind == ProjectionKind::kExrCube && (width * 6 != height || width < 2))
    return fail(ErrorCode::kInvalid, where,
                "the size " + size + " is not that of a cube, N x 6N with N at least 2");
  if (kind == ProjectionKind::kExrLatLong && (width < 2 || height < 2))
    return fail(ErrorCode::kInvalid, where, "the size " + size + " is below 2x2");
  return {};
}

}  // namespace

Result<ProjectionKind> projection_kind(std::string_view name) {
  std::string known;
  for (const auto& [kind, text] : kNames) {
    if (text == name) return kind;
    if (!known.empty()) known += ", ";
    known += text;
  }
  return fail(ErrorCode::kInvalid, std::string(name),
              "is not a known projection, which are " + known);
}

std::string_view projection_name(ProjectionKind kind) {
  for (const auto& [known, text] : kNames)
    if (known == kind) return text;
  return "unknown";
}

Result<CameraModel> make_projection(ProjectionKind kind, int width, int height) {
  PENUMBRA_TRY(check_shape(kind, width, height));
  CameraModel p{kind, width, height, {0, 0}, {width / 2., height / 2.}, {}};
  if (has_intrinsics(kind))  // r = f th reaches pi/2 at half the shorter side
    p.focal_px = glm::dvec2(std::min(width, height) / kPi);
  if (kind == ProjectionKind::kPinhole)  // r = f tan th reaches 30 degrees at half the height
    p.focal_px = glm::dvec2(height / 2. / std::tan(kPi / 6));
  return p;
}

int distortion_count(ProjectionKind kind) {
  switch (kind) {
    case ProjectionKind::kKannalaBrandt:
      return 4;
    case ProjectionKind::kDoubleSphere:
      return 2;
    case ProjectionKind::kPinhole:
      return 5;
    default:
      return 0;
  }
}

bool has_intrinsics(ProjectionKind kind) {
  return kind == ProjectionKind::kEquidistant || distortion_count(kind) > 0;
}

Result<CameraModel> with_distortion(CameraModel p, std::span<const double> distortion) {
  const std::string where(projection_name(p.kind));
  const auto invalid = [&](std::string detail) {
    return fail(ErrorCode::kInvalid, where, std::move(detail));
  };
  const auto largest = static_cast<std::size_t>(distortion_count(p.kind));
  const auto own = distortion.first(std::min(largest, distortion.size()));
  if (std::ranges::any_of(distortion.subspan(own.size()), [](double k) { return k != 0; }))
    return invalid(fmt::format("has {} distortion coefficients instead of at most {}",
                               distortion.size(), largest));
  if (std::ranges::any_of(distortion, [](double k) { return !std::isfinite(k); }))
    return invalid("a distortion coefficient is not finite");
  p.distortion = {};
  std::ranges::copy(own, p.distortion.begin());
  const auto& k = p.distortion;
  if (p.kind == ProjectionKind::kDoubleSphere && !(std::abs(k[0]) < 1 && k[1] >= 0 && k[1] <= 1))
    return invalid("xi is not within -1..1, or alpha is not within 0..1");
  constexpr double kMin = kPi / 6;
  const auto lens = radial_lens(p);
  const double tangent = std::tan(kMin);
  if (lens ? lens->curve.last_theta() < kMin : fold_r2(k) < tangent * tangent)
    return invalid("the distortion is not monotone within 30 degrees of the axis");
  return p;
}

std::optional<glm::dvec3> direction_from_pixel(const CameraModel& p, glm::dvec2 pixel) {
  const auto inside = clamp_into_picture(p, pixel);
  if (!inside) return std::nullopt;
  if (const auto lens = radial_lens(p)) {
    const glm::dvec2 q = (*inside - lens->centre_px) / lens->focal_px;
    if (std::hypot(q.x, q.y) > lens->rim() * (1 + 1e-12)) return std::nullopt;
    return lens->direction(q);
  }
  switch (p.kind) {
    case ProjectionKind::kPinhole: {
      const auto q = undistort(p, (*inside - p.principal_px) / p.focal_px);
      if (!q) return std::nullopt;
      return glm::normalize(glm::dvec3{q->x, -q->y, -1});
    }
    case ProjectionKind::kVerticalCross:
    case ProjectionKind::kExrCube:
      return direction_in_faces(face_layout(p), *inside);
    case ProjectionKind::kExrLatLong:
      return direction_in_exr_latlong(p, *inside);
    default:
      return latlong_direction(inside->x, inside->y, p.width, p.height);
  }
}

std::optional<glm::dvec2> pixel_of_lens(const CameraModel& p, const glm::dvec3& direction) {
  const double length = glm::length(direction);
  if (!(length > 0) || !std::isfinite(length)) return std::nullopt;
  const glm::dvec3 d = direction / length;
  if (p.kind == ProjectionKind::kPinhole) return pinhole_pixel(p, d);
  const auto lens = radial_lens(p);
  const auto q = lens ? lens->coordinates(d) : std::nullopt;
  if (!q) return std::nullopt;
  return lens->centre_px + *q * lens->focal_px;
}

std::optional<glm::dvec2> pixel_from_direction(const CameraModel& p, const glm::dvec3& direction) {
  const double length = glm::length(direction);
  if (!(length > 0) || !std::isfinite(length)) return std::nullopt;
  const glm::dvec3 d = direction / length;
  if (p.kind == ProjectionKind::kPinhole || radial_lens(p)) {
    const auto pixel = pixel_of_lens(p, d);
    return pixel ? clamp_into_picture(p, *pixel) : std::nullopt;
  }
  switch (p.kind) {
    case ProjectionKind::kVerticalCross:
    case ProjectionKind::kExrCube:
      return clamp_into_picture(p, pixel_in_faces(face_layout(p), d));
    case ProjectionKind::kExrLatLong:
      return clamp_into_picture(p, pixel_in_exr_latlong(p, d));
    default:
      return clamp_into_picture(p, latlong_pixel(d, p.width, p.height));
  }
}

}  // namespace penumbra::calib
