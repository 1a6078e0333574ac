// What can stand between a point and a light source.
// threads: plain values
#pragma once

#include <glm/vec3.hpp>
#include <span>

#include "core/pose.h"
#include "lighting/disc.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/rays.h"
#include "prt/transfer/vertex_sight.h"
#include "shadows/silhouette/outline.h"
#include "shadows/silhouette/outline_memo.h"

namespace penumbra::shadows {

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

}  // namespace penumbra::shadows
