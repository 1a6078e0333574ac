// What an ICC profile of matrix and curves says of RGB codes; not for other folders.
// threads: reentrant
#pragma once

#include <array>
#include <glm/mat3x3.hpp>

#include "codec/internal/frame_header.h"
#include "core/result.h"

namespace penumbra::codec {

struct IccProfile {
  /// Columns: the tristimulus values of red, green and blue at the profile's white, D50.
  glm::dmat3 primaries;
  std::array<std::array<float, 256>, 3> linear;  // light of each channel's codes, 0..1
};

/// Of a profile with colorants and tone curves: gamma, table or parametric; without one as sRGB.
/// errors: kUnreadable (none of these, damaged), with no place
/// source: ICC.1:2022, 9.2.46 and neighbours, 10.6 (curveType), 10.18 (parametricCurveType)
Result<IccProfile> parse_icc_profile(Bytes profile);

}  // namespace penumbra::codec
