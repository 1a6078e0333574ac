// A light source's shadow on a plane.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "lighting/disc.h"
#include "prt/geometry/plane.h"
#include "shadows/silhouette/casters.h"

namespace penumbra::shadows {

struct DiscShadowOptions {
  /// Directions of the disc, 1..64; four times as many, 4 to 64, for a broad one. One of another is its middle: a hard shadow.
  int taps = 16;
  /// Cells along the longer side, at least 16; five eighths of them for a broad disc.
  int size = 256;
  /// Of a broad disc so many of these directions are taken, and (1 + fineness)/2 of these cells: 1, 1/2 or 1/4. Steps in the shadow
  /// of what brings little light are small.
  double fineness = 1;
};

/// The share of one disc that virtual things take from a real plane, on a rectangle that holds the whole
/// shadow. 0 at the rim, so that nothing ends abruptly.
struct DiscShadow {
  /// Plane frame: y the normal, x away from the light along the plane, origin at node (0, 0); node
  /// (i, j) lies at (i, 0, j) * cell_m.
  Pose world_from_map;
  float cell_m = 0;
  Image<float> taken;  // nodes: real visibility times the share blocked by virtual things, 0..1
  Image<float>
      missing;  // nodes: share of the disc that real things block; empty without real things
  bool empty() const { return taken.empty(); }
};

/// Exact at every node, for the casters as their outlines have them, for each of the disc's directions that is 1.15 degrees above the plane. Shadows longer than ten radii
/// of the caster are cut off softly.
/// errors: none; an empty shadow when no light of the disc reaches the plane's front, or nothing stands above it
/// threads: reentrant
void draw_disc_shadow(const Casters& casters, const prt::Plane& plane, const lighting::Disc& disc,
                      const DiscShadowOptions& options, DiscShadow& out);

/// A part of a plane, on which something may fall.
struct Neighbourhood {
  glm::dvec3 centre;
  double radius;  // metres
};

/// What real things take of a disc around the given places (`taken`; `missing` stays empty): coarser than the maps of what
/// virtual things take, and wider, since the light that is left counts for the shadow of every other light.
/// in: at least one real thing; virtual ones do not count
void draw_real_shadow(const Casters& casters, std::span<const Neighbourhood> around,
                      const prt::Plane& plane, const lighting::Disc& disc,
                      const DiscShadowOptions& options, DiscShadow& out);

/// A map for each group of virtual casters whose shadows' rectangles meet, so that objects far apart do not share one
/// map's cells. `out` keeps its maps' memory; those not needed are empty.
void draw_disc_shadows(const Casters& casters, const prt::Plane& plane, const lighting::Disc& disc,
                       const DiscShadowOptions& options, std::vector<DiscShadow>& out);

}  // namespace penumbra::shadows
