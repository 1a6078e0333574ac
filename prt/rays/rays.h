// Ray queries over Embree.
// threads: queries reentrant
#pragma once

#include <algorithm>
#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <optional>

#include "core/pose.h"
#include "core/result.h"
#include "prt/geometry/mesh.h"

#pragma GCC visibility push(default)
namespace penumbra::prt {

struct Hit {
  std::uint32_t triangle;
  float distance, u, v;  // position = (1-u-v) a + u b + v c
  bool front;            // seen against the geometric normal
};

/// Triangle rays over Embree.
class RayScene {
 public:
  /// errors: kInvalid (no triangles), kUnavailable (Embree says why)
  static Result<RayScene> build(const Mesh& mesh);
  ~RayScene();
  RayScene(RayScene&&) noexcept;
  RayScene& operator=(RayScene&&) noexcept;

  /// Another form of the same mesh: as many vertices, the same triangles. Only while no ray is
  /// under way.
  void update_vertices(const Mesh& form);

  std::optional<Hit> intersect(const glm::vec3& origin, const glm::vec3& direction, float near,
                               float far = 1e30f) const;
  bool occluded(const glm::vec3& origin, const glm::vec3& direction, float near,
                float far = 1e30f) const;

  /// The place of the mesh that is nearest to a point. Sides that face away from `normal` count as
  /// farther by `behind`: a thin wall's other side is none.
  /// in: a scene of an unmoved mesh
  Hit nearest(const glm::vec3& point, const glm::vec3& normal, float behind) const;

  static constexpr int kPacket = 16;
  struct RayPacket {
    alignas(64) float x[kPacket], y[kPacket], z[kPacket];  // unit directions
    alignas(64) float distance[kPacket], u[kPacket], v[kPacket];
    alignas(64) std::uint32_t triangle[kPacket];  // kMiss or the triangle
    alignas(64) bool front[kPacket];
  };
  static constexpr std::uint32_t kMiss = 0xffffffffu;
  /// Sixteen rays from one origin: nearest hits.
  void intersect(const glm::vec3& origin, float near, RayPacket& packet) const;
  /// Sixteen rays from one origin: bit i is set when ray i is blocked.
  std::uint32_t occluded(const glm::vec3& origin, float near, const RayPacket& packet) const;

 private:
  struct Impl;
  explicit RayScene(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// Meshes at rigid poses in one world, for rays through all of them.
/// threads: occluded() and intersect() reentrant; everything else only while no ray is under way
class RayWorld {
 public:
  /// errors: kUnavailable (Embree says why)
  static Result<RayWorld> create();
  ~RayWorld();
  RayWorld(RayWorld&&) noexcept;
  RayWorld& operator=(RayWorld&&) noexcept;

  /// The number names the mesh from then on.
  /// errors: kInvalid (no triangles), kUnavailable
  Result<int> add(const Mesh& mesh);
  void set_pose(int mesh, const Pose& world_from_mesh);
  /// Another form of the same mesh: as many vertices, the same triangles.
  void update_vertices(int mesh, const Mesh& form);
  /// Takes all meshes out.
  void clear();
  bool empty() const;

  static constexpr int kPacket = 16;
  struct Rays {
    alignas(64) float ox[kPacket], oy[kPacket], oz[kPacket];  // origins, metres
    alignas(64) float dx[kPacket], dy[kPacket], dz[kPacket];  // unit directions
    alignas(64) float far[kPacket];  // metres: occluders beyond do not count
    Rays() { std::fill_n(far, kPacket, 1e30f); }
  };
  /// Bit i is set when one of the first `count` rays, i, is blocked by any mesh but `except`.
  std::uint32_t occluded(const Rays& rays, int count = kPacket, int except = -1) const;
  std::uint32_t occluded_by(int mesh, const Rays& rays, int count = kPacket) const;
  struct Hits {
    alignas(64) float distance[kPacket], u[kPacket], v[kPacket];  // as Hit
    alignas(64) std::uint32_t triangle[kPacket];
    alignas(64) int mesh[kPacket];  // -1: none
    Hits() { std::fill_n(distance, kPacket, 1e30f), std::fill_n(mesh, kPacket, -1); }
  };
  /// Where all rays meet this mesh before what they have met so far.
  void intersect(int mesh, const Rays& rays, Hits& nearest) const;

 private:
  struct Impl;
  explicit RayWorld(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra::prt
#pragma GCC visibility pop
