// How a thing stands on a plane: the part that its bake depends on, and the part that it does not.
// threads: reentrant
#pragma once

#include <glm/gtc/quaternion.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "core/pose.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/geometry/plane.h"
#include "runtime/scene/scene.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// A mesh is baked in its own units, leaned as it stands and with the plane at its height. Where on
/// the plane it stands, how it is turned about the plane's normal and how large it is are left to
/// its placement.
struct Standing {
  glm::dquat tilt{1, 0, 0, 0};  // of the mesh, so that y points along the plane's normal
  float height = 0;             // of the plane then, in the mesh's units
  // From there to the bake frame of the object: metres = scale * (units + shift)
  double scale = 1;
  glm::dvec3 shift{0};
  Pose world_from_bake;
};

/// mesh: in its own frame; plane: under it, or null, which leaves the vertical
Standing standing_of(const Placement& placement, const prt::Mesh& mesh, const prt::Plane* plane);

/// The height that a clip stands on: of its lowest points frame by frame the least that a quarter
/// of them share to a hundredth of its height. One frame that reaches deeper does not lift the
/// others off the floor. Where no height is shared, the lowest of all.
/// in: at least one
float standing_height(std::vector<float> lowest_by_frame, float height);

/// Brings a bake from the mesh's units to its place.
void put_in_place(prt::BakedObject& baked, double scale, const glm::dvec3& shift);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
