// What a scene file that was changed means for a pipeline that runs.
// threads: reentrant
#pragma once

#include "runtime/scene/scene.h"
#include "service/scene_control.h"

namespace penumbra::service {

/// Moves, turns, shows and hides the objects that `now` has otherwise than `last`, which was
/// applied before. The pipeline was made of `at_first`. What takes a restart is said in the log, by
/// name.
void apply_scene(const runtime::Scene& at_first, const runtime::Scene& last,
                 const runtime::Scene& now, SceneControl& objects);

}  // namespace penumbra::service
