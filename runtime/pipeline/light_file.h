// Light from an environment file, for the commands that start from one.
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
};

/// Reads the file and projects it in its own pixels, without resampling. Non-finite pixels are
/// reported in the log and left out.
Result<FileLight> read_light(const std::string& path, const std::optional<std::string>& projection);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
