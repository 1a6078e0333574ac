// What all pieces of tone mapping refuse.
// threads: reentrant
#pragma once

#include <string_view>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tone {

/// errors: kInvalid (value not finite or outside lowest..highest), by the name of the option
Result<void> check_option(std::string_view name, double value, double lowest, double highest);

/// errors: kNonFinite (first bad pixel)
Result<void> check_finite_values(const Image<float>& values, std::string_view name);

}  // namespace penumbra::tone
