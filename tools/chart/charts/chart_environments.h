// The lights that a chart is drawn over.
#pragma once

#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

namespace penumbra::tools {

struct ChartEnvironment {
  std::string name;
  Image<Rgb> map;  // lat-long, linear radiance
};

/// Of the files. The built-in room and clear sky where there are none, or `with_procedural`.
/// errors: as runtime::read_light
Result<std::vector<ChartEnvironment>> read_environments(const std::vector<std::string>& files,
                                                        bool with_procedural);

}  // namespace penumbra::tools
