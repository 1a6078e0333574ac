// What a camera wrote into a JPEG about its exposure.
// threads: reentrant
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/result.h"
#include "core/units.h"

namespace penumbra::tools {

struct ExifExposure {
  Seconds time{0};
  std::optional<double> iso, f_number;
};

/// errors: kNotFound, kUnreadable; kUndetermined (no EXIF, or no exposure time in it)
/// source: EXIF 2.3, tags ExposureTime, ISOSpeedRatings (PhotographicSensitivity), FNumber
Result<ExifExposure> read_exif_exposure(const std::filesystem::path& jpeg);

}  // namespace penumbra::tools
