// Coders that others would take for sequences of transfer maps, for comparison.
// threads: free functions reentrant
#pragma once

#include <filesystem>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

/// Maps as decoded, in their order, and how many bytes they took.
struct CodedMaps {
  std::vector<Image<float>> maps;
  std::size_t bytes = 0;
};

/// One OpenEXR file a frame of `layers` maps, half floats under DWAA; files go to `folder` and are
/// removed.
/// in:     maps frame by frame; level as OpenEXR's dwaCompressionLevel (45 by default, larger is
/// coarser)
/// errors: kUnwritable, kUnreadable
Result<CodedMaps> code_as_exr(std::span<const Image<float>> maps, int layers, float level,
                              const std::filesystem::path& folder);

/// H.264 of ten bits, every picture by itself: a frame's maps side by side, each on its own range
/// over the clip.
/// in:     crf 0..51, larger is coarser
/// errors: kUnavailable (no encoder or decoder)
Result<CodedMaps> code_as_video(std::span<const Image<float>> maps, int layers, int crf);

}  // namespace penumbra::tools
