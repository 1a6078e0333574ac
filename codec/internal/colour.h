// Chromaticities to linear Rec.709, for the file formats that declare them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <span>

#include "core/image.h"

namespace penumbra::codec {

/// CIE xy of the primaries and of white: red, green, blue, white, x before y.
using Chromaticities = std::array<double, 8>;

inline constexpr Chromaticities kRec709{.64, .33, .30, .60, .15, .06, .3127, .3290};

/// Files round the white point in several ways (.3127, .31271); a conversion between those would
/// change every stored number for nothing.
inline bool is_rec709(const Chromaticities& c) {
  return std::ranges::equal(c, kRec709, [](double a, double b) { return std::abs(a - b) < 5e-4; });
}

/// XYZ of an RGB triple, Y = 1 for white. Nothing if the primaries span no volume.
inline std::optional<glm::dmat3> xyz_from_rgb(const Chromaticities& c) {
  const auto column = [&](std::size_t i) {
    return glm::dvec3(c[2 * i], c[2 * i + 1], 1 - c[2 * i] - c[2 * i + 1]);
  };
  const glm::dmat3 primaries(column(0), column(1), column(2));
  const double volume = std::abs(glm::determinant(primaries));
  if (!(volume > 1e-6) || !(volume < 1e6) || !(std::abs(c[7]) > 1e-6)) return std::nullopt;
  const glm::dvec3 scale = glm::inverse(primaries) * (column(3) / c[7]);
  if (!(std::abs(scale.x * scale.y * scale.z) > 1e-9)) return std::nullopt;
  return glm::dmat3(primaries[0] * scale.x, primaries[1] * scale.y, primaries[2] * scale.z);
}

/// Colorimetric, without adaptation to another white: what OpenEXR's own programs do, and the only
/// reading under which openexr-images' XYZ.exr and Rec709.exr are the same picture.
inline std::optional<glm::dmat3> rec709_from(const Chromaticities& c) {
  const auto xyz = xyz_from_rgb(c);
  if (!xyz) return std::nullopt;
  return glm::inverse(*xyz_from_rgb(kRec709)) * *xyz;
}

inline void apply(const glm::dmat3& m, std::span<Rgb> pixels) {
  for (Rgb& p : pixels) {
    const glm::dvec3 v = m * glm::dvec3(p.r, p.g, p.b);
    p = {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
  }
}

}  // namespace penumbra::codec
