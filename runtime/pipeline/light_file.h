// Light from an environment file, for the commands that start from one.
#pragma once

#include <optional>
#include <string>

#include "capture/environment/environment_file.h"
#include "lighting/discs.h"
#include "lighting/governor.h"
#include "lighting/projection.h"
#include "runtime/scene/scene.h"

namespace penumbra::service {

struct FileLight {
  capture::EnvironmentFile file;
  lighting::Projection light{RadianceSh(kMaxBands), RadianceSh(kMaxBands), 1};
};

/// Reads the file and projects it in its own pixels, without resampling. Non-finite pixels are
/// reported in the log and left out.
Result<FileLight> read_light(const std::string& path, const std::optional<std::string>& projection);

/// "auto" (sources that send a facing surface 2 % of the mean irradiance, eight at most) or the most discs.
/// errors: kInvalid
Result<lighting::DiscOptions> choose_discs(const std::string& text);

/// errors: kInvalid
Result<void> check_budget(double budget);

/// For a scene. `fitted`: costs measured here and now; else fixed ones,
/// so that a replay makes the same choices everywhere.
/// errors: kUnavailable
Result<lighting::Governance> make_governance(const PreparedScene& scene, double budget,
                                             bool fitted);

/// "auto" or 1..9. Auto: the fewest bands that keep the unshadowed irradiance within 0.5 %.
/// errors: kInvalid
Result<int> choose_bands(const std::string& text, const lighting::Projection& nine_bands);

}  // namespace penumbra::service
