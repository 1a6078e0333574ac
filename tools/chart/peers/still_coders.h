// Coders of HDR pictures, ours and others', for comparison.
// threads: one at a time, as a coder's settings go through the environment
#pragma once

#include <cstddef>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

struct CodedPicture {
  Image<Rgb> decoded;
  std::size_t bytes = 0;
  double encode_ms = 0, decode_ms = 0;
};

struct StillCoder {
  std::string coder, setting;
  /// errors: kUnavailable (a library lacks the coder); as the coder's own
  std::function<Result<CodedPicture>(const Image<Rgb>&)> code;
};

/// Each at several settings, fine to coarse: log JPEG 2000 (ours, both coders of blocks, and within
/// an error at every pixel), the dissertation's RGBE in three ways, Radiance's, gain-map JPEG
/// (ours), OpenEXR with PIZ and DWAA, JPEG XL, and AVIF as a picture of AV1 in 10-bit PQ. Pictures
/// of even sides; files go to `folder` and are removed.
std::vector<StillCoder> still_coders(const std::filesystem::path& folder);

}  // namespace penumbra::tools
