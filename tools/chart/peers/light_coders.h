// Video coders that others would take for maps of the surroundings, for comparison.
// threads: one at a time, as a coder's settings go through the environment
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

enum class LightCoder {
  kHevcPq,   // HEVC, 10 bits, 4:2:0, PQ as HDR video has it
  kAv1Pq,    // AV1, the same
  kHevcLog,  // HEVC, 12 bits, LogLuv as the light track, but suns stay in the picture
};
std::string name_of(LightCoder coder);

/// Maps as decoded, in their order, and how many bytes they took.
struct CodedLight {
  std::vector<Image<Rgb>> maps;
  std::size_t bytes = 0;
};

/// As the light track: every so many maps one by itself.
inline constexpr int kLightCoderKeys = 30;

/// A key map, then differences from the map before. PQ's brightest code is the maps' largest
/// value.
/// in:     maps of one size, even, not empty, none negative; quantiser 0..51, of AV1 0..63
/// errors: kUnavailable (FFmpeg lacks the coder)
/// source: PQ: SMPTE ST 2084; YCbCr: ITU-R BT.2100, full range
Result<CodedLight> code_light(LightCoder coder, std::span<const Image<Rgb>> maps, int quantiser);

}  // namespace penumbra::tools
