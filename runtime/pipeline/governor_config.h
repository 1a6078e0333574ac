// What the governor has to know of a scene.
// threads: reentrant
#pragma once

#include "core/result.h"
#include "lighting/governor.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// Of all objects: what the floors under them lose, as baked, and some of their own points.
lighting::SceneProbes scene_probes(const PreparedScene& scene);

/// Times of reading a map, of relighting this scene and of tracing one light in it on one thread,
/// fitted here and now.
/// errors: kUnavailable (Embree)
Result<lighting::CostModel> fit_costs(const PreparedScene& scene);

/// For a scene. `fitted`: costs measured on this machine, at the first start with such a scene, and
/// kept in the cache folder; else fixed ones, so that a replay makes the same choices everywhere.
/// errors: kUnavailable
Result<lighting::GovernorConfig> make_governor_config(const PreparedScene& scene, double budget,
                                                      bool fitted);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
