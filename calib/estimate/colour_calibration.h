// Estimation of what carries the radiance of one camera into another's.
// threads: reentrant
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <glm/mat3x3.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/colour.h"
#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// How many numbers stand between two cameras: sensors of one make need a scale, of one kind gains,
/// others a matrix.
enum class ColourModel { kMatrix, kGains, kScale };

/// "matrix", "gains", "scale".
/// errors: kInvalid naming them
Result<ColourModel> colour_model(std::string_view name);

struct ColourCalibration {
  glm::dmat3 matrix{1};           // target = matrix * source
  glm::dmat3 sigma{0};            // one standard deviation of each element
  double rms = 0;                 // of the used pairs' residuals, relative to the target's mean
  std::vector<double> residuals;  // of each pair, in their order
  std::vector<bool> used;         // false: too far off to show the same surface
};

/// Least squares of relative residuals, with Tukey's weights from a start by medians: pairs that do
/// not show the same surface (parallax, something that moved, a reflection) have no say while they
/// are clearly fewer than a half.
/// errors: kUndetermined (fewer than 8 pairs; too few colours for the model: which number stays
/// unknown; the pairs disagree by more than a tenth), kNonFinite (a pair)
/// source: IRLS with Tukey's biweight, Beaton & Tukey 1974; scale by the median absolute deviation
Result<ColourCalibration> calibrate_colour(std::span<const ColourPair> pairs, ColourModel model);

/// Mean radiance of the 24 patches of a ColorChecker in a picture, dark skin first, row by row;
/// nothing where a patch is clipped or black. `clipped` may be empty.
/// errors: kUndetermined (no chart, one too small or cut off)
Result<std::vector<std::optional<Rgb>>> find_colour_chart(const Image<Rgb>& radiance,
                                                          const Image<std::uint8_t>& clipped,
                                                          const std::string& picture);

/// "version = 1" and [colour] with `matrix` by rows; how sure it is beside it.
std::string print_colour_file(const ColourCalibration& calibration, std::string_view source,
                              std::string_view target);
}  // namespace penumbra::calib
#pragma GCC visibility pop
