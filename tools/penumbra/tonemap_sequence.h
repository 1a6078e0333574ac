// Tone mapping of HDR pictures that follow each other.
// threads: reentrant
#pragma once

#include <cstddef>
#include <filesystem>
#include <vector>

#include "codec/tone/tone_mapping.h"
#include "core/result.h"

namespace penumbra::tools {

struct ToneSequence {
  std::vector<std::filesystem::path> pictures;  // in their order; for a video of one size
  std::filesystem::path output;                 // .mp4, or a folder for PNG files of the same names
  tone::ToneOptions tone;
  double frames_per_second = 30;
  double adaptation_s = .4;  // time constant, 0 for each picture by itself
};

/// The HDR pictures of a folder, but for JPEGs, which may be ordinary ones, in the order of their
/// names, numbers by their value; a file is itself.
/// errors: kNotFound (a folder without any)
Result<std::vector<std::filesystem::path>> pictures_of(const std::filesystem::path& path);

/// A progress bar tells how far it is. Pictures before one that fails stay, a video does not.
/// errors: kInvalid (sizes that differ, two pictures of one name), what reading, mapping and
/// writing say
Result<void> tonemap_sequence(const ToneSequence& sequence);

}  // namespace penumbra::tools
