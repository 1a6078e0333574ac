#include "tools/chart/charts/chart_environments.h"

#include <filesystem>
#include <utility>

#include "capture/studio/environments.h"
#include "runtime/pipeline/light_file.h"

namespace penumbra::tools {

Result<std::vector<ChartEnvironment>> read_environments(const std::vector<std::string>& files,
                                                        bool with_procedural) {
  std::vector<ChartEnvironment> out;
  for (const std::string& path : files) {
    PENUMBRA_ASSIGN(light, runtime::read_light(path));
    PENUMBRA_ASSIGN(map, runtime::whole_latlong(light));
    out.push_back({std::filesystem::path(path).stem().string(), std::move(map)});
  }
  if (!files.empty() && !with_procedural) return out;
  out.push_back({"room", capture::make_room_environment(1024, 512)});
  out.push_back({"clear-sky", capture::make_sky_environment(1024, 512, .8)});
  return out;
}

}  // namespace penumbra::tools
