// What all programs of the command line share: a table of arguments in, one line of error out.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <string>

#include "core/result.h"

namespace penumbra::tools {

/// What the arguments ask for; run after parsing.
using Action = std::function<Result<void>()>;

/// Of the shadow ratio's RMS error, kept with 95 % confidence; the mean error comes out at a quarter of it.
inline constexpr double kDefaultMaxShadowError = .05;

inline constexpr const char* kMaxLightsHelp =
    "Maximum number of distant lights, 0 to 64, or auto (8)";
inline constexpr const char* kMaxShadowErrorHelp =
    "RMS error of the shadow ratio that the governor keeps to, within --bands and --max-lights";

/// Why an empty text is refused; empty for any other.
std::string not_empty(const std::string& text);
void add_json(CLI::App* app, bool& json);

/// Parses and runs. Returns the exit status: 0, or 2 after one line on standard error.
int run_program(int argc, char** argv, const std::string& name, const std::string& description,
                const std::function<void(CLI::App&, Action&)>& add_commands);

}  // namespace penumbra::tools
