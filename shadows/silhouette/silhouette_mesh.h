// The edges of a mesh with the triangles at both sides: what its shadow on a plane is drawn from.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::shadows {

/// threads: const members reentrant
class SilhouetteMesh {
 public:
  static constexpr std::uint32_t kOpen = 0xffffffffu;

  /// The left triangle goes along the edge from `from` to `to`, the right one goes back. Where none
  /// goes back (a rim, a third triangle, one that is wound the wrong way) right is kOpen.
  struct Edge {
    std::uint32_t from, to;  // positions of the mesh
    std::uint32_t left, right;
  };
  using Triangle = std::array<std::uint32_t, 3>;

  SilhouetteMesh() = default;
  /// Vertices in one place count as one, in every form: seams of normals or texture coordinates are
  /// no rims.
  /// `max_off_m`: triangles are joined where the surface moves by no more (by meshoptimizer's
  /// estimate) and keep vertices of the mesh. Not for meshes that will take other forms: what is
  /// even now may bend then.
  /// source: Garland & Heckbert 1997, "Surface Simplification Using Quadric Error Metrics"
  explicit SilhouetteMesh(const prt::Mesh& mesh, float max_off_m = 0);
  /// Another form of the same mesh: as many vertices, the same triangles.
  void update_vertices(const prt::Mesh& mesh);

  /// In the order of their higher ends, then of their lower ones.
  std::span<const Edge> edges() const { return edges_; }
  /// Those with three different corners, by the first of the vertices in each place.
  std::span<const Triangle> triangles() const { return triangles_; }

  /// The normals of triangles(), as long as twice the areas.
  struct Normals {
    std::vector<float> x, y, z;
  };
  const Normals& normals() const { return normals_; }
  /// Edges that lie together, kTogether at a time in their order.
  struct Patch {
    glm::vec3 centre{0};  // of a sphere around the edges
    float radius_m = 0;
    /// Around the normals of the triangles at them. A sine of kAnywhere where one is off the axis
    /// by a right angle or more, or where an edge is open.
    glm::vec3 axis{0};
    float sine = kAnywhere, cosine = 0;
  };
  static constexpr std::size_t kTogether = 16;
  static constexpr float kAnywhere = 2;
  static constexpr float kNear = 1e-4f;  // of the radius: how far off a surface its vertices look
  std::span<const Patch> patches() const { return patches_; }
  std::span<const Edge> edges_of(std::size_t patch) const {
    const std::size_t first = patch * kTogether;
    return edges().subspan(first, std::min(kTogether, edges_.size() - first));
  }

  const prt::Bounds& bounds() const { return bounds_; }
  float mean_length_m() const { return mean_length_m_; }  // of an edge
  float radius_m() const { return radius_m_; }            // around the middle of the mesh's bounds

 private:
  std::vector<Triangle> triangles_;
  std::vector<Edge> edges_;
  Normals normals_;
  std::vector<Patch> patches_;
  prt::Bounds bounds_{};
  float mean_length_m_ = 0, radius_m_ = 0;
};

}  // namespace penumbra::shadows
#pragma GCC visibility pop
