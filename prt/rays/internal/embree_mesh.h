// A triangle mesh as an Embree scene.
#pragma once

#include <embree3/rtcore.h>

#include "prt/geometry/mesh.h"

namespace penumbra::prt {

/// A committed scene that the caller releases; null when Embree refuses.
RTCScene build_embree_scene(RTCDevice device, const Mesh& mesh, RTCSceneFlags flags);
/// Gives it another form: as many vertices. From the first time on it is built fast, not well: each
/// form lasts for one frame.
void set_embree_form(RTCScene scene, const Mesh& form);

}  // namespace penumbra::prt
