// Where the vertices of a mesh lie on a simpler one.
// threads: reentrant and internally parallel (TBB)
#pragma once

#include "core/result.h"
#include "prt/geometry/fine_form.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

/// A mesh that gets its light from a coarse one, each vertex from the nearest place that faces its
/// way.
/// errors: kInvalid (the coarse one has no triangles), kUnavailable (Embree)
Result<FineForm> lit_by(Mesh fine, const Mesh& coarse);

}  // namespace penumbra::prt
#pragma GCC visibility pop
