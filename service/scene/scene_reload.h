// What a scene file that was changed means for a pipeline that runs.
// threads: reentrant
#pragma once

#include "runtime/scene/scene.h"
#include "service/scene/scene_control.h"

namespace penumbra::service {

/// Moves, turns, shows and hides the objects that `now` has otherwise than `last`, which was
/// applied before. The pipeline was made of `shown`.
/// out: whether there is more to it: objects that are new, gone or to be baked otherwise, or other
/// real things. Those take SceneControl::follow_file().
bool apply_scene(const runtime::Scene& shown, const runtime::Scene& last, const runtime::Scene& now,
                 SceneControl& objects);

}  // namespace penumbra::service
