// Virtual lamps, small spheres, and luminous surfaces: they light what is near, real and virtual.
// threads: reentrant, parallel inside
#pragma once

#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/shadow_map.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

struct Lamp {
  glm::dvec3 position{0, 1, 0};  // world, metres
  double radius_m = .03;         // of the sphere: penumbras
  Rgb irradiance_at_1m;  // of a surface that faces it, in the units of the environment's light
};

/// A luminous surface as points: each sends an equal share of its light, by the cosine.
struct Emitter {
  std::vector<glm::vec3> positions, normals;  // world, metres; unit
  float point_m2 = 0;                         // area that a point stands for
  bool double_sided = false;
};

/// out[i] = mean over the lamp's face of V max(n.w, 0)/d^2: times irradiance_at_1m it is an
/// irradiance. Points inside the lamp count as on its surface.
/// in: unit normals; samples 1..64 rays a point
void trace_lamp_points(const RayOccluders& occluders, std::span<const glm::vec3> positions,
                       std::span<const glm::vec3> normals, const Lamp& lamp, int samples,
                       std::span<float> out);

/// The same at the vertices of a mesh.
void trace_lamp_light(const RayOccluders& occluders, const prt::Mesh& mesh,
                      const Pose& world_from_mesh, const Lamp& lamp, int samples,
                      std::span<float> out);

/// What the lamp sends to a real plane, as a map of its own brightest value: `out.taken` 0..1,
/// which fades to 0 at the rim, five lamp heights out (1 % of the middle). Returns that value, as
/// trace_lamp_points; 0 and an empty map for a lamp behind the plane.
float trace_lamp_map(const RayOccluders& occluders, const prt::Plane& plane, const Lamp& lamp,
                     int samples, ShadowMap& out);

/// The same three for a luminous surface: the mean over its points of V max(n.w, 0) max(-m.w, 0)
/// over d^2 + point_m2/pi, with m a point's normal: exact for a small disc, seen along its normal.
/// Times radiance and area of the surface it is an irradiance. A mesh's vertex asks every fourth
/// point.
/// in: at least one point; what hides may be the surface itself
void trace_emitter_points(const RayOccluders& occluders, std::span<const glm::vec3> positions,
                          std::span<const glm::vec3> normals, const Emitter& emitter,
                          std::span<float> out);
void trace_emitter_light(const RayOccluders& occluders, const prt::Mesh& mesh,
                         const Pose& world_from_mesh, const Emitter& emitter, std::span<float> out);
/// Reaches five times as far as the surface is high; 0 where all of it lies behind the plane.
float trace_emitter_map(const RayOccluders& occluders, const prt::Plane& plane,
                        const Emitter& emitter, ShadowMap& out);

}  // namespace penumbra::shadows
#pragma GCC visibility pop
