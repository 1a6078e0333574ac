// What the governor has to know of a scene.
// threads: reentrant
#pragma once

#include "core/result.h"
#include "lighting/governor.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// The baked probes of all objects on a floor.
lighting::ShadowProbes shadow_probes(const PreparedScene& scene);

/// Time of relighting and of tracing one light in this scene on one thread, fitted.
/// errors: kUnavailable (Embree)
Result<lighting::CostModel> fit_costs(const PreparedScene& scene);

/// For a scene. `fitted`: costs measured here and now; else fixed ones, so that a replay makes the
/// same choices everywhere.
/// errors: kUnavailable
Result<lighting::GovernorConfig> make_governor_config(const PreparedScene& scene, double budget,
                                                      bool fitted);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
