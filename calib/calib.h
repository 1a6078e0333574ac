// Camera models: where each pixel looks, how its code follows from light, how noisy it is.
// Camera frame: looks along -z, +y up in the picture, +x right (conventions.h).
// threads: every function is reentrant; all types are plain values
#pragma once

#include <algorithm>
#include <array>
#include <filesystem>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::calib {

// ---------------------------------------------------------------------------------- projection

enum class ProjectionKind {
  kLatLong,  // whole sphere, conventions.h
  kAngular,  // whole sphere, radius proportional to the angle from -z; inscribed circle (Debevec)
  kMirrorBall,   // orthographic mirror ball, r = R sin(th/2); inscribed circle; exactly equal area
  kEquidistant,  // fisheye r = f th
  kKannalaBrandt,  // fisheye r = f (th + k1 th^3 + k2 th^5 + k3 th^7 + k4 th^9); Kannala & Brandt 2006
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

/// How many numbers `distortion` has: kb4 k1..k4, double-sphere xi, alpha; pinhole k1 k2 p1 p2 k3, in the order and
/// meaning of OpenCV.
int distortion_count(ProjectionKind kind);
/// Whether the kind has focal_px and principal_px.
bool has_intrinsics(ProjectionKind kind);

/// Kind, size and, for lenses, the intrinsics in continuous pixels.
struct Projection {
  ProjectionKind kind = ProjectionKind::kLatLong;
  int width = 0, height = 0;
  glm::dvec2 focal_px{0, 0};
  glm::dvec2 principal_px{0, 0};
  std::array<double, 5> distortion{};  // distortion_count(kind) of them are used
  [[nodiscard]] bool is_distorted() const {
    return std::ranges::any_of(distortion, [](double k) { return k != 0; });
  }
};

/// A projection with defaults filled in: principal point in the middle; fisheyes: 180 degrees
/// across the shorter side, undistorted; pinhole: 60 degrees across the height.
/// errors: kInvalid (size, aspect of a cross)
Result<Projection> make_projection(ProjectionKind kind, int width, int height);

/// Direction in the camera frame seen at a continuous pixel; nothing outside the picture's valid
/// area.
std::optional<glm::dvec3> direction_from_pixel(const Projection& projection, glm::dvec2 pixel);

/// Sets the distortion; missing numbers at the end are 0, and zeros too many do no harm.
/// errors: kInvalid (too many, not finite, xi not within -1..1 or alpha not within 0..1, a lens whose picture folds back
/// before 30 degrees off the axis)
Result<Projection> with_distortion(Projection projection, std::span<const double> distortion);

/// Inverse; nothing where the camera does not look (behind a pinhole, outside a fisheye's picture).
std::optional<glm::dvec2> pixel_from_direction(const Projection& projection,
                                               const glm::dvec3& direction);

/// Per pixel: unit direction through its centre, exact solid angle (integrated over the pixel's
/// valid part; pixels partly outside the sphere's image count only their part), confidence 0..1 (0
/// = not seen). The solid angles of a whole-sphere projection sum to 4 pi within 1e-6. source:
/// central radial lens r(th): dw/dA = sin th/(r r'); mirror ball 4/R^2; plane element of a cube
struct ProjectionTable {
  int width = 0, height = 0;
  std::vector<glm::vec3> direction;
  std::vector<float> solid_angle_sr;
  std::vector<float> confidence;
};
ProjectionTable make_projection_table(const Projection& projection);

// ---------------------------------------------------------------------------------- response

/// Camera response f: linear signal in 0..1 of full scale -> code in 0..1, per channel, monotone.
class Response {
 public:
  static Response linear();
  static Response srgb();  // IEC 61966-2-1
  static Response gamma(double exponent);
  /// Inverse response sampled at `decode.size()` equidistant codes, per channel; must be monotone
  /// non-decreasing, 2 samples or more.
  /// errors: kInvalid
  static Result<Response> from_table(std::array<std::vector<float>, 3> decode);

  /// The same behind gains per channel between sensor and response. Only their ratios matter: the smallest
  /// counts as 1, the exposure has the rest.
  /// errors: kInvalid (not positive and finite)
  Result<Response> with_white_balance(const std::array<double, 3>& gains) const;
  const std::array<double, 3>& white_balance() const { return white_balance_; }

  double decode(double code, int channel) const;    // code 0..1 -> linear 0..1
  double encode(double linear, int channel) const;  // clamps to 0..1
  /// Decoded value of each of 2^bits codes (bits 8 or 16), for one channel.
  std::vector<float> decode_table(int bits, int channel) const;
  bool same_for_all_channels() const;
  bool is_linear() const;
  std::string describe() const;  // "srgb", "gamma:2.2", "table of 256"

 private:
  enum class Form { kLinear, kSrgb, kGamma, kTable };
  Form form_ = Form::kLinear;
  double curve_decode(double code, int channel) const;
  double curve_encode(double linear, int channel) const;
  double exponent_ = 1;
  std::array<double, 3> white_balance_{1, 1, 1};
  std::shared_ptr<const std::array<std::vector<float>, 3>> table_;
};

/// "linear", "srgb", "gamma:2.2", or the path of a TOML file (relative to `folder`) with
/// `version = 1` and `decode = [[..], [..], [..]]` (one list serves all three channels).
/// errors: kInvalid, kNotFound, kUnreadable
Result<Response> parse_response(const std::string& text, const std::filesystem::path& folder = {});
Result<void> write_response(const std::filesystem::path& path, const Response& response);
/// Such a file's text; `path` names it in errors.
Result<Response> parse_response_file(std::string_view text, const std::filesystem::path& path);
std::string print_response_file(const Response& response);

/// Response from a registered 8-bit bracket by the equations of Debevec & Malik 1997, clipped codes
/// left out, made monotone; masked pixels are pure blue (0,0,255) registration borders. errors:
/// kInvalid (fewer than 2 pictures, sizes), kUndetermined (equal times, no overlap, one colour)
Result<Response> estimate_response(std::span<const Image<Rgb8>* const> pictures,
                                   std::span<const Seconds> times);

struct ResponseCalibration {
  Response response;
  double sigma = 0;  // one standard deviation of the curve, RMS over the codes, of full scale
  std::optional<double>
      between_places;  // RMS difference between the curves of the left and the right half over the codes that both hold
};

/// estimate_response with how sure it is.
/// errors: as estimate_response; kUndetermined (the curve depends on the place: local tone mapping)
Result<ResponseCalibration> calibrate_response(std::span<const Image<Rgb8>* const> pictures,
                                               std::span<const Seconds> times);

// ---------------------------------------------------------------------------------- noise

/// Signal y in fractions of full scale at gain g: var(y) = g y / full_well + (g read)^2, where
/// `full_well` is in electrons at gain 1 and `read` in fractions of full scale at gain 1.
/// Quantisation is added by whoever knows the bit depth.
/// source: Hasinoff et al. 2010, eq. 1-3
struct NoiseModel {
  double full_well_electrons = 20000;
  double read_fraction = 5e-4;
  double variance(double y, double gain) const {
    return gain * y / full_well_electrons + gain * gain * read_fraction * read_fraction;
  }
};

}  // namespace penumbra::calib

// The calibrations are about the cameras above, so they come after them.
#include "calib/boards.h"                  // IWYU pragma: export
#include "calib/camera_calibration.h"      // IWYU pragma: export
#include "calib/colour_calibration.h"      // IWYU pragma: export
#include "calib/mirror_ball.h"             // IWYU pragma: export
#include "calib/noise_calibration.h"       // IWYU pragma: export
#include "calib/rig_calibration.h"         // IWYU pragma: export
#include "calib/vignetting_calibration.h"  // IWYU pragma: export
