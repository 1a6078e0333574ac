// The page's cube map in the sizes, formats and axes that applications ask for.
// threads: reentrant
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "service/client/penumbra_light_page.h"
#include "service/openxr/light_estimation.h"
#include "service/openxr/space_rotation.h"

namespace penumbra::openxr {

inline constexpr std::array<std::uint32_t, 5> kCubeSizes = {16, 32, 64, 128, 256};
inline constexpr std::array kCubeFormats = {
    XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32_SFLOAT_ANDROID,
    XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R32G32B32A32_SFLOAT_ANDROID,
    XR_CUBEMAP_LIGHTING_COLOR_FORMAT_R16G16B16A16_SFLOAT_ANDROID};

/// 0 for a format that is not one of kCubeFormats.
std::size_t texel_bytes(XrCubemapLightingColorFormatANDROID format);

/// Right, left, top, bottom, front (-z), back (+z): the order of XrCubemapLightingDataANDROID.
using CubeImages = std::array<std::vector<std::uint8_t>, 6>;

/// Looks the page's cube up along `world_from_cube` times the directions of the new faces. Smaller
/// faces are means, larger ones are interpolated within a face of the page.
/// size: one of kCubeSizes; out: keeps its memory
void make_faces(const penumbra_cube& cube, const SpaceRotation& world_from_cube, std::uint32_t size,
                XrCubemapLightingColorFormatANDROID format, CubeImages& out);

}  // namespace penumbra::openxr
