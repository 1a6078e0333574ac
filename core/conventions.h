// The only statement of Penumbra's conventions. Everything else points here.
//
// World      right-handed, metres, y up, -z forward (OpenXR, glTF). Column vectors, column-major.
// Directions unit length, pointing TOWARDS the light.
// Radiance   linear Rec.709 RGB float, relative units. Luminance Y = .2126 R + .7152 G + .0722 B.
// Pixels     continuous coordinates: the image's top-left corner is (0, 0), the centre of the first
//            pixel (.5, .5). A camera looks along its -z with +y up in the picture.
// Lat-long   w x h: u = (i + .5)/w, polar angle th = pi (j + .5)/h from +y, azimuth
//            p = 2 pi (u - .5), d = (sin th sin p, cos th, -sin th cos p). The centre column looks
//            along -z, +x to its right.
//            Exact solid angle of row j: w_j = (2 pi/w)(cos(pi j/h) - cos(pi (j+1)/h)).
// SH         real, orthonormal, NO Condon-Shortley phase, evaluated on world x, y, z with z as the
//            mathematical pole (c = z, p = atan2(y, x)); Y_1,-1..1 = .488603 (y, z, x).
//            Index n = l*l + l + m. "bands" B means l < B, so B*B coefficients; never "order".
//            Light l_n = sum_i w_i L_i Y_n(d_i). Transfer t_n = (1/pi) Int V max(n.d, 0) Y_n dw
//            with the receiving albedo left out: exit radiance rho sum l_n t_n, E = pi sum l_n t_n.
// threads: reentrant
#pragma once

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <numbers>

#include "core/image.h"

#pragma GCC visibility push(default)
namespace penumbra {

inline constexpr double kPi = std::numbers::pi;
inline constexpr int kMaxBands = 9;
inline constexpr int kMaxCoefficients = kMaxBands * kMaxBands;

constexpr int coefficient_count(int bands) {
  return bands * bands;
}
constexpr int sh_index(int l, int m) {
  return l * l + l + m;
}

inline constexpr float kLuminance[] = {.2126f, .7152f, .0722f};
constexpr float luminance(const Rgb& c) {
  return kLuminance[0] * c.r + kLuminance[1] * c.g + kLuminance[2] * c.b;
}

inline bool is_finite(const Rgb& c) {
  return std::isfinite(c.r) && std::isfinite(c.g) && std::isfinite(c.b);
}

/// Direction of a continuous lat-long pixel position.
inline glm::dvec3 latlong_direction(double x_px, double y_px, int width, int height) {
  const double theta = kPi * y_px / height;
  const double phi = 2 * kPi * (x_px / width - .5);
  return {std::sin(theta) * std::sin(phi), std::cos(theta), -std::sin(theta) * std::cos(phi)};
}

/// Continuous lat-long pixel position of a direction; x in [0, width], y in [0, height].
inline glm::dvec2 latlong_pixel(const glm::dvec3& d, int width, int height) {
  const double phi = std::atan2(d.x, -d.z);
  const double theta = std::acos(std::fmin(1., std::fmax(-1., d.y / glm::length(d))));
  return {width * (phi / (2 * kPi) + .5), height * theta / kPi};
}

/// Exact solid angle in steradian of every pixel in row j of a lat-long map.
inline double latlong_solid_angle(int j, int width, int height) {
  return 2 * kPi / width * (std::cos(kPi * j / height) - std::cos(kPi * (j + 1) / height));
}

}  // namespace penumbra
#pragma GCC visibility pop
