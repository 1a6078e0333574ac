// A light source's irradiance at vertices, through everything that stands in its way.
// threads: reentrant, parallel inside
#pragma once

#include <span>
#include <vector>

#include "lighting/lights/distant_light.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "shadows/silhouette/occluders.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

/// A narrow light at an object's vertices, for what is drawn between them: its mean cosine is
/// open * clamp(lit, 0, 1), each interpolated before. Both are empty where that is not known.
struct EdgedFractions {
  std::vector<float> open;  // mean cosine over the light, with nothing in its way
  std::vector<float> lit;   // visible fraction; beyond 0..1 beside an edge sharper than the mesh
};

/// Estimates the direct irradiance from one light at each vertex. Chooses rays or baked
/// visibility: docs/methods/direct-light.md says when.
/// in:      occluders, casters: the same things, `object` among them, with the same near_m
///          plane: the one that the mesh stands on, or null; light from behind it is the bake's
///          samples: 1..64, rays a vertex at most. One is the light's middle: the shadow is hard,
///          and what faces all of the light keeps its light
/// out:     out[v] = mean over the light of V max(n.w, 0); times L Omega/pi it is the exit radiance
///          of a white surface
///          edged: empty for wide lights, for those whose penumbras are wider than the mesh's edges
///          or that are looked up, and for those whose middle is behind the plane; null: not asked
///          for
/// threads: reentrant, parallel inside
/// source:  stratified samples of the cap (Vogel spiral), turned from vertex to vertex, or of a
///          form's points by the golden ratio
void trace_direct_light(const RayOccluders& occluders, const ShadowCasters& casters,
                        const Caster& object, const prt::Plane* plane,
                        const lighting::DistantLight& source, int samples, std::span<float> out,
                        EdgedFractions* edged = nullptr);

/// Fractions of one distant light at a mesh's vertices, as mean cosines over the light: of all of
/// it, of what virtual things take, and of what real things take anyway. Times L Omega each is an
/// irradiance.
struct DirectLightAtVertices {
  std::vector<float> open, virtual_occlusion, real_occlusion;
};
/// Under wide lights neighbours are averaged as far as few rays explain what they differ by.
/// in:      the mesh in the world frame; samples 1..64, one is the light's middle
/// threads: reentrant, parallel inside
void trace_direct_light_at_vertices(const RayOccluders& occluders, const prt::Mesh& mesh,
                                    const lighting::DistantLight& source, int samples,
                                    DirectLightAtVertices& out);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
