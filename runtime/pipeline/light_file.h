// Light from an environment file, for the commands that start from one.
// threads: reentrant
#pragma once

#include <optional>
#include <string>

#include "capture/environment/environment_file.h"
#include "lighting/governor.h"
#include "lighting/lights/light_extraction.h"
#include "lighting/sh/projection.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

struct FileLight {
  capture::EnvironmentFile file;
  lighting::ShProjection light{RadianceSh(kMaxBands), RadianceSh(kMaxBands), 1};
  RadianceSh residual{1};  // what goes on where the file shows nothing
};

/// How an environment file is to be read.
struct EnvironmentOrientation {
  std::optional<std::string> projection{};  // instead of what the file or its shape says
  double rotation_deg = 0;                  // about the vertical, counter-clockwise seen from above
};

/// Reads the file and projects it: in its own pixels, or by way of lat-long where it does not show
/// all. Non-finite pixels are
/// reported in the log and left out, as are directions that the file does not show; a projection
/// against the file's own word is said there too.
/// errors: as capture::read_environment; kInvalid (unknown projection, rotation not in -360..360)
Result<FileLight> read_light(const std::string& path,
                             const EnvironmentOrientation& orientation = {});

/// The file as a whole lat-long picture. What it does not show is filled by three bands of its
/// light without its compact lights, which go on from what it shows
/// (docs/methods/environment-assembly.md).
/// errors: none that read_light lets through
Result<Image<Rgb>> whole_latlong(const FileLight& light);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
