// What the governor has to know of a scene.
// threads: reentrant
#pragma once

#include "core/result.h"
#include "lighting/governor.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {

/// Of all objects: what the floors under them lose, as baked, and some of their own points, world
/// frame.
/// in: bands that objects are relit with at most
lighting::SceneProbes scene_probes(const PreparedScene& scene, int bands);

/// Times of reading a map, of relighting this scene and of tracing one light in it on one thread,
/// fitted here and now.
/// errors: kUnavailable (Embree)
Result<lighting::CostModel> fit_costs(const PreparedScene& scene);

enum class CostSource {
  kFixed,   // a replay makes the same choices everywhere
  kFitted,  // here and now
  kKept     // at the first start with such a scene on this machine, kept in the cache folder
};
/// errors: kUnavailable
Result<lighting::GovernorConfig> make_governor_config(const PreparedScene& scene,
                                                      const lighting::Governor::Limits& limits,
                                                      CostSource costs);

}  // namespace penumbra::runtime
