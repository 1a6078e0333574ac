// A light source's irradiance at vertices, through everything that stands in its way.
// threads: reentrant, parallel inside
#pragma once

#include <span>
#include <vector>

#include "lighting/disc.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "shadows/silhouette/casters.h"

namespace penumbra::shadows {

/// out[v] = mean over the disc of V max(n.w, 0) at every vertex: times L Omega/pi it is the exit radiance of a
/// white surface. `plane` is the one that the mesh stands on, or null: light from behind it is the bake's. `casters` are
/// the same things as `blockers`, `object` among them, with the same near_m: their outlines tell which vertices share rays, and
/// in a small disc's penumbra which of sixteen directions, or of `taps` if those are more, a vertex sees. One tap is the disc's
/// middle, and the shadow hard; what faces all of the disc keeps its light. Of a disc that is wide beside the cells of the
/// object's sight this is asked instead of rays (up to eight; four for lamps of a few degrees), where nothing else may stand between the two.
/// Half of the vertices look for all then, if the disc is wide beside edges too (a vertex that grazes it stays dark where all that look
/// for it are turned away), and under small discs they tell which vertices need rays.
/// in: taps 1..64, rays a vertex at most; threads: reentrant, parallel inside
/// source: stratified samples of the cap (Vogel spiral), turned from vertex to vertex, or of a form's points by the golden
/// ratio; Laine et al. 2005 (PartSeen)
void trace_disc_light(const Blockers& blockers, const Casters& casters, const Caster& object,
                      const prt::Plane* plane, const lighting::Disc& disc, int taps,
                      std::span<float> out);

/// Shares of a disc's light at a mesh's vertices, as mean cosines over the disc: of all of it, of what virtual things
/// take, and of what real things take anyway. Times L Omega each is an irradiance.
struct DiscAtVertices {
  std::vector<float> open, taken, missing;
};
/// Neighbours share the light of broad discs, whatever the lengths of edges.
/// in: the mesh in the world frame; taps 1..64, one is the disc's middle. threads: reentrant, parallel inside
void trace_disc_vertices(const Blockers& blockers, const prt::Mesh& mesh,
                         const lighting::Disc& disc, int taps, DiscAtVertices& out);

}  // namespace penumbra::shadows
