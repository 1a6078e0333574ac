// Where the edge of a narrow light's shadow runs between an object's vertices.
#pragma once

#include <glm/vec3.hpp>
#include <span>

#include "core/pose.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/visibility_map.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::shadows {

/// The visible fraction of a light by vertex, such that clamping it to 0..1 after interpolation
/// over a triangle shows the shadow's edge where it is, and not as wide as the triangle. Vertices
/// beside an edge that is narrower than their triangles lie beyond 0..1, by their distance from it.
/// in:      mesh, its place; towards: the light's middle, unit, world frame
///          sums: by vertex, of the directions that were asked for it; open 0: turned away
/// out:     lit: 0 for vertices that are turned away
/// threads: reentrant, parallel inside
/// source:  a distance to an edge keeps it sharp under linear interpolation, Green 2007
void find_shadow_edge(const RayOccluders& occluders, const prt::Mesh& mesh,
                      const Pose& world_from_mesh, const glm::vec3& towards,
                      std::span<const prt::CosineSums> sums, std::span<float> lit);

}  // namespace penumbra::shadows
