// Normals and tangents for what comes without them.
// threads: reentrant
#pragma once

#include <glm/vec3.hpp>

#include "prt/geometry/gltf/internal/primitives.h"

namespace penumbra::prt::gltf {

/// Where faces that meet in a place turn by less than 80 degrees their vertices share a normal, the
/// mean of the faces' by the angle that each has there. glTF asks for flat faces; scans come
/// without normals and are smooth, and what is baked lies at vertices, of which flat faces would
/// have three each. All of the primitive's lists are made anew, by corners.
/// source: Thürmer & Wüthrich 1998
void make_normals(Primitive& primitive);

/// By the derivatives of the place in the map, in each triangle, averaged at vertices by area and
/// made perpendicular to the normal. Vertices whose triangles show the map both ways round are
/// split.
/// source: Lengyel, Mathematics for 3D Game Programming, 7.8
void make_tangents(Primitive& primitive, const Texture& map);

/// The unit part of `along` that is perpendicular to the unit `normal`; any where there is none.
glm::vec3 perpendicular(const glm::vec3& along, const glm::vec3& normal);

}  // namespace penumbra::prt::gltf
