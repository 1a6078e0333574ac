// What all programs of the command line share: a table of arguments in, one line of error out.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <span>
#include <string>

#include "core/result.h"
#include "tools/common/arguments.h"

namespace penumbra::tools {

/// What the arguments ask for; run after parsing.
using Action = std::function<Result<void>()>;

/// Of the RMS errors of shadows and objects, kept with 95 % confidence; the mean error comes out at
/// a quarter of it.
inline constexpr double kDefaultMaxShadowError = .05;

inline constexpr const char* kMaxLightsHelp = "Maximum number of distant lights, 0 to 64; auto: 8";
inline constexpr const char* kMaxShadowErrorHelp =
    "Limit of the RMS error of the shadow ratio, and of the objects relative to their own light, "
    "above 0 and at most 1: the governor takes the cheapest light that keeps to it, within --bands "
    "and --max-lights";
/// Of commands in which the governor chooses the bands.
inline constexpr const char* kMaxBandsHelp =
    "Maximum number of bands of spherical harmonics, 1 to 9";
/// Of commands that choose the bands by the map's irradiance.
inline constexpr const char* kBandsOfMapHelp =
    "Number of bands of spherical harmonics, 1 to 9; auto: the fewest that keep the unshadowed "
    "irradiance within 0.5 %";
inline constexpr const char* kProjectionHelp =
    "Projection of the environment map: latlong, angular, mirror-ball, equidistant, pinhole, "
    "vertical-cross, exr-latlong or exr-cube; by default what an OpenEXR file states, else what "
    "the "
    "shape says";
inline constexpr const char* kRotationHelp =
    "Turn the environment map about the vertical by this many degrees, counter-clockwise seen from "
    "above, -360 to 360";

/// A command that is a program of its own, standing beside this one.
struct Sibling {
  const char *command, *program, *help;
  bool is_subcommand;  // of that program; else the program is the command itself
};

void add_json(CLI::App* app, bool& json);

/// For a program that ends soon: memory of pictures that come and go is not given back to the
/// system in between. That took a fifth of the time of calibrations and charts.
void keep_freed_memory();

/// Parses and runs. Returns the exit status: 0, or 2 after one line on standard error. `siblings`
/// are told in help, manual page and completion.
int run_program(int argc, char** argv, const std::string& name, const std::string& description,
                const std::function<void(CLI::App&, Action&)>& add_commands,
                std::span<const Sibling> siblings = {});

}  // namespace penumbra::tools
