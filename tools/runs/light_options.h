// What the commands' options say of light.
// threads: reentrant
#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "core/result.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/projection.h"
#include "runtime/pipeline/light_file.h"

namespace penumbra::tools {

/// "auto" (sources that send a facing surface 2 % of the mean irradiance, eight at most) or the
/// most lights.
/// errors: kInvalid
Result<lighting::ExtractionOptions> choose_max_lights(const std::string& text);

/// errors: kInvalid
Result<void> check_max_shadow_error(double value);

/// "auto" or 1..9. Auto: the fewest bands that keep the unshadowed irradiance within 0.5 %.
/// errors: kInvalid
Result<int> choose_bands(const std::string& text, const lighting::ShProjection& nine_bands);

/// --projection and --rotate-environment.
void add_orientation(CLI::App& app, runtime::EnvironmentOrientation& orientation);

}  // namespace penumbra::tools
