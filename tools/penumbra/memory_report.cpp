#include "tools/penumbra/memory_report.h"

#include "runtime/scene/shadow_sampling.h"
#include "runtime/shading/object_memory.h"

namespace penumbra::tools {

namespace {

constexpr Rgb kSomeAlbedo{.4f, .4f, .4f};

}  // namespace

nlohmann::json report_memory(const prt::BakedObject& baked) {
  const prt::BakedObject object = prt::on_floor(baked, kSomeAlbedo);
  const runtime::ObjectMemory memory = runtime::memory_of(object, runtime::RelightBases(object),
                                                          runtime::ShadowSampling{}.plane.size);
  const auto megabytes = [](std::size_t bytes) { return static_cast<double>(bytes) / 1e6; };
  return {{"mesh_mb", megabytes(memory.mesh)},
          {"surface_mb", megabytes(memory.surface)},
          {"ground_mb", megabytes(memory.ground)},
          {"shadow_mb", megabytes(memory.shadows)},
          {"visibility_mb", megabytes(memory.visibility)},
          {"without_lights_mb", megabytes(memory.without_lights())},
          {"a_light_mb", megabytes(memory.bytes_a_light)}};
}

}  // namespace penumbra::tools
