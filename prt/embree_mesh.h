// A triangle mesh as an Embree scene.
#pragma once

#include <embree3/rtcore.h>

#include "prt/prt.h"

namespace penumbra::prt {

/// A committed scene that the caller releases; null when Embree refuses.
RTCScene build_embree_scene(RTCDevice device, const Mesh& mesh, RTCSceneFlags flags);

}  // namespace penumbra::prt
