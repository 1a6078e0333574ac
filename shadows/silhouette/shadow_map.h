// A light source's shadow on a plane.
// threads: reentrant
#pragma once

#include <algorithm>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/plane.h"
#include "shadows/silhouette/occluders.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

struct ShadowMapOptions {
  /// Directions of a narrow light, 1 to 64; a wide one takes four times as many, 4 to 64. With 1, a
  /// narrow light is traced by its middle: a hard shadow.
  int samples = 16;
  /// Cells along the longer side, at least 16; five eighths of them for a wide light.
  int size = 256;
  /// Of a wide light so many of these directions are taken, and (1 + resolution_scale)/2 of these
  /// cells: 1, 1/2 or 1/4. Steps in the shadow of what brings little light are small.
  double resolution_scale = 1;

  /// For a light whose shadow's steps nobody will see: a quarter of the directions, four at least,
  /// and half of the cells along a side.
  ShadowMapOptions coarse() const {
    return {std::min(samples, std::max(4, samples / 4)), std::max(16, size / 2), resolution_scale};
  }
};

/// The fraction of one light that virtual things take from a real plane, on a rectangle that holds
/// the whole shadow. 0 at the rim, so that nothing ends abruptly.
struct ShadowMap {
  /// Plane frame: y the normal, x away from the light along the plane, origin at node (0, 0); node
  /// (i, j) lies at (i, 0, j) * cell_m.
  Pose world_from_map;
  float cell_m = 0;
  // Nodes: real visibility times the fraction blocked by virtual things, 0..1
  Image<float> virtual_occlusion;
  // Nodes: fraction of the light that real things block; empty without real things
  Image<float> real_occlusion;
  bool empty() const { return virtual_occlusion.empty(); }
};

/// A part of a plane, on which something may fall.
struct Neighbourhood {
  glm::dvec3 centre;
  double radius;  // metres
};

/// What real things take of a light around the given places (`virtual_occlusion`; `real_occlusion`
/// stays empty): coarser than the maps of what virtual things take, and wider, since the light that
/// is left counts for the shadow of every other light.
/// in: at least one real thing; virtual ones do not count
void render_real_shadow_map(const ShadowCasters& casters, std::span<const Neighbourhood> around,
                            const prt::Plane& plane, const lighting::DistantLight& source,
                            const ShadowMapOptions& options, ShadowMap& out);

/// A map for each group of virtual casters whose shadows' rectangles meet, so that objects far
/// apart do not share one map's cells. Exact at every node, for the casters as their silhouettes
/// have them, for each of the light's directions that is 1.15 degrees above the plane. Shadows
/// longer than ten radii of the caster are cut off softly. `out` keeps its maps' memory; those not
/// needed are empty.
/// errors: none; no map where none of the light reaches the plane's front, or nothing stands above
/// it
/// threads: reentrant
void render_shadow_maps(const ShadowCasters& casters, const prt::Plane& plane,
                        const lighting::DistantLight& source, const ShadowMapOptions& options,
                        std::vector<ShadowMap>& out);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
