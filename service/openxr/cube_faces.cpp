#include "service/openxr/cube_faces.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace penumbra::openxr {

std::size_t texel_bytes(XrCubemapLightingColorFormatANDROID format) {
  switch (format) {
    case XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32_SFLOAT_ANDROID:
      return 12;
    case XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32A32_SFLOAT_ANDROID:
      return 16;
    case XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R16G16B16A16_SFLOAT_ANDROID:
      return 8;
    default:
      return 0;
  }
}

namespace {

constexpr std::size_t kEdge = PENUMBRA_PAGE_CUBE;
// The page has +z before -z, the extension the front before the back.
constexpr std::array<std::size_t, 6> kPageFace = {0, 1, 2, 3, 5, 4};

// IEEE 754 binary16. An own one: the layer is loaded into programs that have no other library.
float from_half(std::uint16_t half) {
  const std::uint32_t sign = (half & 0x8000u) << 16, rest = half & 0x7fffu;
  if (rest >= 0x7c00) return std::bit_cast<float>(sign | 0x7f800000u | (rest & 0x3ffu) << 13);
  // Exponents differ by 112; multiplied, numbers below the normal ones come out right, too.
  return std::bit_cast<float>(sign | rest << 13) * std::bit_cast<float>((127u + 112u) << 23);
}

std::uint16_t to_half(float value) {
  const float bounded = std::clamp(value, 0.f, 65504.f);  // no radiance is below 0
  if (!(bounded >= std::bit_cast<float>(0x38800000u)))    // below 2^-14: steps of 2^-24; NaN is 0
    return static_cast<std::uint16_t>(bounded > 0 ? std::lrint(bounded * 16777216.f) : 0);
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(bounded) - (112u << 23);
  return static_cast<std::uint16_t>((bits + 0xfffu + (bits >> 13 & 1)) >>
                                    13);  // to the nearest even
}

using Rgb3 = std::array<float, 3>;
using FloatCube = std::vector<Rgb3>;  // faces, rows, columns as in the page

FloatCube floats_of(const penumbra_cube& cube) {
  FloatCube out;
  out.reserve(6 * kEdge * kEdge);
  for (const auto& face : cube.texels)
    for (const auto& row : face)
      for (const auto& texel : row)
        out.push_back({from_half(texel[0]), from_half(texel[1]), from_half(texel[2])});
  return out;
}

// The table of penumbra_light_page.h: s and t run from -1 to 1.
Vector3 direction_of(std::size_t face, float s, float t) {
  switch (face) {
    case 0:
      return {1, -t, -s};
    case 1:
      return {-1, -t, s};
    case 2:
      return {s, 1, t};
    case 3:
      return {s, -1, -t};
    case 4:
      return {s, -t, 1};
    default:
      return {-s, -t, -1};
  }
}

struct FacePoint {
  std::size_t face;
  float s, t;
};

FacePoint point_of(const Vector3& d) {
  const float x = std::abs(d[0]), y = std::abs(d[1]), z = std::abs(d[2]);
  if (x >= y && x >= z) return {d[0] > 0 ? 0u : 1u, (d[0] > 0 ? -d[2] : d[2]) / x, -d[1] / x};
  if (y >= z) return {d[1] > 0 ? 2u : 3u, d[0] / y, (d[1] > 0 ? d[2] : -d[2]) / y};
  return {d[2] > 0 ? 4u : 5u, (d[2] > 0 ? d[0] : -d[0]) / z, -d[1] / z};
}

Rgb3 look_up(const FloatCube& cube, const Vector3& d) {
  const FacePoint at = point_of(d);
  const auto place = [](float s) {
    return std::clamp((s + 1) / 2 * static_cast<float>(kEdge) - .5f, 0.f,
                      static_cast<float>(kEdge - 1));
  };
  const float x = place(at.s), y = place(at.t);
  const auto i = std::min(static_cast<std::size_t>(x), kEdge - 2);
  const auto j = std::min(static_cast<std::size_t>(y), kEdge - 2);
  const float u = x - static_cast<float>(i), v = y - static_cast<float>(j);
  const Rgb3* corner = &cube[(at.face * kEdge + j) * kEdge + i];
  Rgb3 out{};
  for (std::size_t c = 0; c < 3; ++c)
    out[c] = (1 - v) * ((1 - u) * corner[0][c] + u * corner[1][c]) +
             v * ((1 - u) * corner[kEdge][c] + u * corner[kEdge + 1][c]);
  return out;
}

void put_texel(const Rgb3& rgb, XrCubemapLightingColorFormatANDROID format, std::uint8_t* to) {
  const std::array<float, 4> rgba = {rgb[0], rgb[1], rgb[2], 1};
  if (format != XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R16G16B16A16_SFLOAT_ANDROID) {
    std::memcpy(to, rgba.data(), texel_bytes(format));
    return;
  }
  std::array<std::uint16_t, 4> halves{};
  for (std::size_t c = 0; c < 4; ++c) halves[c] = to_half(rgba[c]);
  std::memcpy(to, halves.data(), sizeof halves);
}

}  // namespace

void make_faces(const penumbra_cube& cube, const SpaceRotation& world_from_cube, std::uint32_t size,
                XrCubemapLightingColorFormatANDROID format, CubeImages& out) {
  const FloatCube floats = floats_of(cube);
  const std::size_t bytes = texel_bytes(format);
  const std::uint32_t looks = std::max(1u, static_cast<std::uint32_t>(kEdge) / size);
  const float step = 2 / static_cast<float>(size * looks);
  const float share = 1 / static_cast<float>(looks * looks);
  for (std::size_t f = 0; f < 6; ++f) {
    out[f].resize(std::size_t{size} * size * bytes);
    std::uint8_t* to = out[f].data();
    for (std::uint32_t row = 0; row < size; ++row)
      for (std::uint32_t column = 0; column < size; ++column, to += bytes) {
        Rgb3 mean{};
        for (std::uint32_t k = 0; k < looks * looks; ++k) {
          const float s = (static_cast<float>(column * looks + k % looks) + .5f) * step - 1;
          const float t = (static_cast<float>(row * looks + k / looks) + .5f) * step - 1;
          const Rgb3 seen =
              look_up(floats, rotated(world_from_cube, direction_of(kPageFace[f], s, t)));
          for (std::size_t c = 0; c < 3; ++c) mean[c] += share * seen[c];
        }
        put_texel(mean, format, to);
      }
  }
}

}  // namespace penumbra::openxr
