// JPEG 2000 codestreams of planes by OpenJPH and OpenJPEG; not for other folders.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "codec/internal/light_planes.h"
#include "core/result.h"

namespace penumbra::codec {

/// Below this OpenJPH 0.9 makes streams that do not decode, or aborts.
inline constexpr int kMinFastSide = 64;

/// needs:  sides of kMinFastSide
/// coarseness: step of the wavelets' coefficients over the planes' range, above 0; 0: no loss
/// errors: kUnwritable
Result<std::vector<unsigned char>> encode_fast_wavelets(const LightPlanes& planes,
                                                        double coarseness);

/// coarseness: how many times smaller than the planes as they are, at least 1; 0: no loss
/// errors: kUnwritable
Result<std::vector<unsigned char>> encode_small_wavelets(const LightPlanes& planes,
                                                         double coarseness);

/// Either kind; the scale is left as it is.
/// errors: kUnreadable, kInvalid (too large, or larger than so few bytes can tell)
Result<LightPlanes> decode_wavelets(std::span<const unsigned char> codestream,
                                    const std::string& name);

/// A codestream of fewer bytes than this is not read: a few bytes cannot claim gigabytes.
std::size_t min_codestream_bytes(std::int64_t width, std::int64_t height);

}  // namespace penumbra::codec
