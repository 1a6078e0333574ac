// Vertices that are alike become one.
// threads: reentrant
#pragma once

#include "prt/geometry/material.h"
#include "prt/geometry/mesh.h"

namespace penumbra::prt {

/// Equal vertices become one, to the bit (0 and -0 are one): in all that they have, also in the
/// surface where there is one. Those that no triangle uses go, since they would be baked for
/// nothing. The others keep the order in which triangles name them.
void weld(Mesh& mesh, SurfaceMaterials* surface = nullptr);

}  // namespace penumbra::prt
