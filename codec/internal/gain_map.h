// What a gain map's file says about it; not for other folders.
#pragma once

#include <array>
#include <cmath>
#include <string_view>

#include "codec/codec.h"
#include "codec/display.h"

namespace penumbra::codec {

/// Radiance from a base and its gain, channel by channel:
///   radiance = ((base + base_offset) 2^(min + (max - min) code^(1/gamma)) - offset) / exposure
/// with the base linear, 1 its white, and the code of the map 0..1.
/// source: Adobe, "Gain Map Specification" 1.0, section "Decode"; ISO 21496-1:2025 says the same
struct GainMap {
  std::array<float, 3> min_log2{0, 0, 0}, max_log2{0, 0, 0}, gamma{1, 1, 1};
  std::array<float, 3> base_offset{1.f / 64, 1.f / 64, 1.f / 64};
  std::array<float, 3> offset{1.f / 64, 1.f / 64, 1.f / 64};
  bool base_is_hdr = false;
  bool in_base_primaries = true;

  float radiance(std::size_t c, float base, float code) const {
    const float part = gamma[c] == 1 ? code : std::pow(code, 1 / gamma[c]);
    const float log2 = min_log2[c] + (max_log2[c] - min_log2[c]) * part;
    return (base + base_offset[c]) * std::exp2(log2) - offset[c];
  }
};

constexpr std::string_view kXmpHead{"http://ns.adobe.com/xap/1.0/\0", 29};
constexpr std::string_view kIsoHead{"urn:iso:std:iso:ts:21496:-1\0", 28};
constexpr std::string_view kPicturesHead{"MPF\0", 4};
// Of our own: the factor on radiance that makes 1 the white of the base.
constexpr std::string_view kExposureSpace = "urn:penumbra:gain-map:1.0";

/// Linear light of sRGB codes.
inline std::array<float, 256> linear_codes() {
  std::array<float, 256> out{};
  for (std::size_t code = 0; code < out.size(); ++code)
    out[code] = linear_from_srgb(static_cast<float>(code) / 255);
  return out;
}

}  // namespace penumbra::codec
