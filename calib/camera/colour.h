// Colours of one camera beside those of another.
// threads: reentrant
#pragma once

#include <glm/mat3x3.hpp>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::calib {

/// One surface as two cameras measure it, linear radiance in units of each.
struct ColourPair {
  Rgb source, target;
};

/// Whether a matrix carries colours: finite, white stays positive, no colour becomes its mirror
/// image.
/// errors: kInvalid
Result<void> check_colour_matrix(const glm::dmat3& matrix);

}  // namespace penumbra::calib
#pragma GCC visibility pop
