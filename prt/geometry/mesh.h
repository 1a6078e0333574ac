// Triangle meshes: made, read, transformed.
// threads: reentrant
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/image.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Mesh {
  // Those that no triangle uses are points to be baked and lit, e.g. texels
  std::vector<glm::vec3> positions;
  std::vector<glm::vec3> normals;                       // unit, one per position
  std::vector<Rgb> albedo;                              // 0..1, one per position
  std::vector<std::array<std::uint32_t, 3>> triangles;  // counter-clockwise seen from outside
};

struct Bounds {
  glm::vec3 low, high;
  glm::vec3 centre() const { return .5f * (low + high); }
};
Bounds bounds_of(const Mesh& mesh);
/// By vertex, the first one in the same place, to the bit (0 and -0 are one): normals and the like
/// split vertices where the surface goes on.
std::vector<std::uint32_t> places_of(std::span<const glm::vec3> positions);
/// The vertex of a triangle that is nearest to the point (1-u-v) a + u b + v c.
std::uint32_t nearest_corner(const Mesh& mesh, std::size_t triangle, float u, float v);
/// Largest distance of a vertex from `centre`.
float radius_around(const Mesh& mesh, const glm::vec3& centre);
/// The same around the middle of its bounds.
float radius_of(const Mesh& mesh);
/// Metres of the unit that its numbers are likely in: 1, .01 of one larger than 7 m, .001 of one
/// larger than 316 m. Files are to be in metres; exporters that forget it write centimetres or
/// millimetres.
float likely_unit_m(const Mesh& mesh);
/// Affine map of positions; normals follow by the inverse transpose.
void transform(Mesh& mesh, const glm::dmat4& matrix);
void append(Mesh& mesh, const Mesh& other);
/// A closed surface, each edge between two triangles that agree on their side, whose volume is
/// negative as a whole is turned round, and its normals with it where they face inwards too.
/// out: whether it was
bool turn_outwards(Mesh& mesh);
/// Splits every edge longer than `longest_edge` (shared edges alike, so no cracks); at most
/// `triangle_limit` triangles. Vertex transfer needs edges shorter than the shading features.
/// Returns of what edge each new vertex is the middle, in their order.
std::vector<std::array<std::uint32_t, 2>> subdivide(Mesh& mesh, float longest_edge,
                                                    std::size_t triangle_limit = 400'000);

/// Sphere from a subdivided icosahedron, unit outward normals.
Mesh make_sphere(const glm::vec3& centre, float radius, int subdivisions, Rgb albedo);
/// Axis-aligned box with flat faces of n x n quads.
Mesh make_box(const glm::vec3& low, const glm::vec3& high, int n, Rgb albedo);
/// (2, 3) torus knot resting on y = 0: the shape of the built-in demo.
Mesh make_knot(float height, int segments, int sides, Rgb albedo);

struct SurfaceMaterials;

struct Import {
  Mesh mesh;
  std::size_t degenerate_triangles = 0;  // removed
  // What the file says of the surface beyond an albedo (material.h); null: nothing
  std::shared_ptr<const SurfaceMaterials> surface{};
  std::vector<std::string> left_out{};    // of the file, a line each: not drawn, or approximated
  std::vector<std::string> extensions{};  // of glTF: those that the file uses
};
/// glTF (.gltf, .glb), OBJ, PLY, STL, FBX or COLLADA, at rest pose; normals are made where absent.
/// Materials give the albedo, `default_albedo` where there is none. In glTF it is base colour times
/// the colour of the vertex and the mean of the texture around it, of metal too, which passes as
/// much light on; emission does not count. The mesh is whole where alpha masks parts of it away
/// (masked.h).
/// errors:  kNotFound, kUnreadable, kInvalid (no triangles, all degenerate; glTF: a bad index, what
/// lies outside the asset's folder, an extension that is required and not read), kNonFinite (vertex
/// named)
Result<Import> import_mesh(const std::filesystem::path& path, Rgb default_albedo);

}  // namespace penumbra::prt
#pragma GCC visibility pop
