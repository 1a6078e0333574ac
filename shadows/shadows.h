// What a virtual object does to the light on the real receiver under it.
// threads: reentrant; compose_planar_shadow does not allocate once `out` has its size
#pragma once

#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/sh.h"
#include "lighting/lighting.h"
#include "prt/prt.h"
#include "shadows/lamp.h"             // IWYU pragma: export
#include "shadows/occlusion_field.h"  // IWYU pragma: export
#include "shadows/outline.h"          // IWYU pragma: export
#include "shadows/outline_memo.h"     // IWYU pragma: export

namespace penumbra::shadows {

/// The ratio s = E/E0 on the receiver at the texels of the object's ground grid. Exactly 1 where
/// the object's influence cannot be seen.
struct PlanarShadow {
  Image<Rgb> ratio;
  /// Texels [x0, x1) x [y0, y1) that hold everything different from 1; empty when x0 >= x1.
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  bool empty() const { return x0 >= x1 || y0 >= y1; }
};

/// Ratios closer to 1 than this are 1 (a third of an 8-bit sRGB code at most); up to twice as far
/// they are faded in, so that the border cannot be seen. This is what keeps the touched area small.
inline constexpr float kInvisibleRatio = .003f;
/// Where E0 is below this share of the mean over all directions, the ratio form has no footing: s
/// = 1.
inline constexpr float kLeastIrradiance = .05f;

/// Light on a receiver, in its bake frame.
struct ReceiverLight {
  ReceiverLight(const RadianceSh& rest_) : rest(rest_) {}  // NOLINT: light without discs is light
  RadianceSh rest;                                         // without the discs
  RadianceSh discs{1};  // the discs in spherical harmonics, for the light that the object reflects
  Rgb disc_irradiance;  // E of all discs on the open receiver, W/m^2 relative
};

/// What the object takes of the receiver's irradiance/pi at its grid's texels under `rest`, less what it reflects of `discs`, in
/// prt::relight's layout.
struct ReceiverChange {
  const prt::GroundGrid& grid;
  int bands;  // of the deficit
  std::size_t stride;
  std::span<const float> taken;
};
void compose_planar_shadow(const ReceiverChange& change, const ReceiverLight& light,
                           PlanarShadow& out);

/// s = 1 - (sum l_n S_n - light reflected from discs)/E0 from the baked deficit basis S_n, clamped to 0..1.5,
/// faded to 1 over the outer tenth of the grid. E0 counts the discs; what of them the object blocks is
/// DiscShadow's. `light` in the bake frame: a yaw of the object is a rotation of the light.
/// in:     object with a receiver
/// errors: kInvalid (no receiver)
Result<void> compose_planar_shadow(const prt::BakedObject& object, const ReceiverLight& light,
                                   PlanarShadow& out);

struct PlacedShadow {
  const prt::BakedObject* object;
  Pose world_from_bake;  // both on one plane
  const PlanarShadow* shadow;
};

/// Shadows of two objects are multiplied where they meet, which darkens twice where both block the same
/// directions. This changes the second's ratio (`out`, a copy of second.shadow) so that the product is 1 - (d_a + d_b -
/// what they block in common), the common part from the correlation of their deficits over all directions. It
/// lies within max(d) .. min(1, sum d); equal objects in one place darken once, separate directions add up. So with
/// what both brighten by reflected light.
/// threads: reentrant, parallel inside; no allocation
void share_shadow(const PlacedShadow& first, const PlacedShadow& second, PlanarShadow& out);

// ---------------------------------------------------------------------------------- discs

/// Whether a disc reaches .05 radians (2.9 degrees) or more from its middle: many vertices lie in its penumbras, which need
/// more directions and less detail than a sun's.
bool is_broad(const lighting::Disc& disc);

struct BoundingSphere {
  glm::dvec3 centre;
  double radius;
};
/// Whether anything in the one sphere may stand between anything in the other and some of a disc.
bool may_hide(const BoundingSphere& one, const BoundingSphere& from, const lighting::Disc& disc);

/// What can stand between a point and a disc.
struct Blockers {
  const prt::RayWorld* virtual_things = nullptr;
  const prt::RayWorld* real_things = nullptr;  // null or empty: none
  float near_m = 1e-4f;                        // rays start so far off their surface
};

struct Caster {
  const prt::Mesh* mesh;
  const Outline* outline;  // of the mesh as it is, or simplified (for planes)
  Pose world_from_mesh;
  const prt::SightLookup* sight = nullptr;  // of the mesh as it is; null: not known
};

/// What throws shadows on a plane.
struct Casters {
  std::span<const Caster> virtual_things, real_things;
  float near_m = 1e-4f;  // what stands lower throws none
  /// Of this disc; null: every call looks for outlines by itself. Two threads must not use one at a time.
  OutlineMemo* memo = nullptr;
};

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
