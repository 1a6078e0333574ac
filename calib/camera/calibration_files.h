// What the calibrations have found, read from their files by whoever uses the camera.
// threads: reentrant
#pragma once

#include <array>
#include <filesystem>
#include <glm/mat3x3.hpp>
#include <string_view>
#include <vector>

#include "calib/camera/colour.h"
#include "calib/camera/noise.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// errors: kInvalid (line, key; as check_colour_matrix), kUnreadable; `path` names the text in
/// errors
Result<glm::dmat3> parse_colour_file(std::string_view text, const std::filesystem::path& path);

struct NoiseFile {
  NoiseModel model;
  double black_level = 0;
};
/// errors: kInvalid (line, key), kUnreadable; `path` names the text in errors
Result<NoiseFile> parse_noise_file(std::string_view text, const std::filesystem::path& path);

/// errors: kInvalid (line, key), kUnreadable; `path` names the text in errors
Result<std::array<double, 3>> parse_vignetting_file(std::string_view text,
                                                    const std::filesystem::path& path);

/// How sure a lens is, from the file of its calibration: the covariance of focal_px, principal_px
/// and the distortion's terms, row by row.
/// errors: kInvalid (line, key; a file without it), kUnreadable; `path` names the text in errors
Result<std::vector<double>> parse_lens_covariance(std::string_view text,
                                                  const std::filesystem::path& path);

}  // namespace penumbra::calib
#pragma GCC visibility pop
