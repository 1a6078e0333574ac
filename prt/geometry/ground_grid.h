// The part of a plane that an object's shadow reaches.
// threads: reentrant
#pragma once

#include "prt/geometry/mesh.h"
#include "prt/geometry/receiver.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// The grid that an object needs: out to five radii of its bounding sphere, where an upright object
/// takes less than 1 % of the light (deficit R^2 h/d^3).
GroundGrid fit_ground_grid(const Mesh& mesh, float plane_height, int size = 128);

}  // namespace penumbra::prt
#pragma GCC visibility pop
