// What can stand between a point and a light source.
// threads: plain values
#pragma once

#include <glm/vec3.hpp>
#include <span>

#include "core/pose.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"
#include "prt/transfer/visibility_map.h"
#include "shadows/silhouette/silhouette_cache.h"
#include "shadows/silhouette/silhouette_mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

/// Whether a light reaches .05 radians (2.9 degrees) or more from its middle: many vertices lie in
/// its penumbras, which need more directions and less detail than a sun's.
bool is_wide(const lighting::DistantLight& source);

struct BoundingSphere {
  glm::dvec3 centre;
  double radius;
};
/// Whether anything in the one sphere may stand between anything in the other and some of a light.
bool may_occlude(const BoundingSphere& one, const BoundingSphere& from,
                 const lighting::DistantLight& source);

/// What can stand between a point and a light.
struct RayOccluders {
  const prt::RayWorld* virtual_things = nullptr;
  const prt::RayWorld* real_things = nullptr;  // null or empty: none
  float near_m = 1e-4f;                        // rays start so far off their surface
  // Real things that come and go; as real_things.
  const prt::RayWorld* passing_things = nullptr;
};

struct Caster {
  const prt::Mesh* mesh;
  const SilhouetteMesh* silhouette;  // of the mesh as it is, or simplified (for planes)
  Pose world_from_mesh;
  const prt::VisibilityLookup* visibility = nullptr;  // of the mesh as it is; null: not known
  /// It or what is beside it moves: no time is spent on grain.
  bool hurried = false;
};

/// What casts shadows on a plane.
struct ShadowCasters {
  std::span<const Caster> virtual_things, real_things;
  float near_m = 1e-4f;  // what stands lower casts none
  /// Of this light; null: every call looks for silhouettes by itself. Two threads must not use one
  /// at a time.
  SilhouetteCache* cache = nullptr;
};

}  // namespace penumbra::shadows
#pragma GCC visibility pop
