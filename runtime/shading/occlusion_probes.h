// What stands around each virtual object: the directions that other objects and real geometry hide
// from it, and how brightly they shine there instead. Low frequencies alone; lights have their own
// rays.
// threads: thread-bound
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "core/pose.h"
#include "core/sh.h"
#include "prt/geometry/mesh.h"
#include "runtime/scene/scene.h"
#include "shadows/field/occlusion_field.h"
#include "shadows/silhouette/occluders.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// b_n = Int (fraction of the surface that sees something else there) Y_n dw, world frame.
struct BlockedSh {
  std::array<float, shadows::kMaxFieldBands * shadows::kMaxFieldBands> blocked{};
  float fraction = 0;  // of the sphere
};

/// An object has ten sides: up and down its bake frame's y, and eight around it from +x over +z. A
/// normal n belongs to up or down by n_y^2, with the rest to the two sides around that it lies
/// between. The weights sum to 1.
inline constexpr int kProbeDirections = 10;
inline float direction_weight(const glm::vec3& normal, int side) {
  const float n = normal.y;
  if (side < 2) return (n > 0) == (side == 0) ? n * n : 0;
  const float x = std::abs(normal.x), z = std::abs(normal.z), largest = std::max(x, z);
  if (largest == 0) return 0;
  const int quarter = (side - 2) / 2;  // +x, +z, -x, -z, each followed by its diagonal
  const bool diagonal = side % 2 != 0;
  // Tangents instead of angles: no more than 4 degrees beside them.
  const float to_diagonal = std::min(x, z) / largest, around = std::max(0.f, 1 - n * n);
  if (diagonal) {
    const bool right = quarter == 0 || quarter == 3, front = quarter < 2;
    return (normal.x > 0) == right && (normal.z > 0) == front ? to_diagonal * around : 0;
  }
  const bool along_x = quarter % 2 == 0, positive = quarter < 2;
  if ((x >= z) != along_x || ((along_x ? normal.x : normal.z) > 0) != positive) return 0;
  return (1 - to_diagonal) * around;
}

/// A point of the floor that a side sees, and how much of its light comes from there.
struct FloorPoint {
  glm::vec3 position;
  float weight;
};

/// What one side of an object sees of other things.
struct ProbeView {
  BlockedSh by_real, by_virtual;  // above the floor
  /// Fractions of the side's irradiance under even light from everywhere (a form factor): what of
  /// the floor it sees, and what other things hide of it.
  float floor = 0, floor_behind_real = 0, floor_behind_virtual = 0;
  std::vector<FloorPoint> floor_points;  // weights sum to `floor`
};

class OcclusionProbes {
 public:
  /// The scene must outlive it.
  explicit OcclusionProbes(const PreparedScene& scene);

  /// False for an object alone on one plane: nothing needs to be looked at.
  bool any() const {
    return scene_->objects.size() > 1 || !scene_->real_mesh.triangles.empty() ||
           scene_->planes.size() > 1;
  }

  /// Looks around from every object, with rays from all over its surface that it does not block
  /// itself. The same again when nothing has moved costs nothing.
  /// in:  occluders as made for this scene (as DirectLightStage::occluders)
  void look(const shadows::RayOccluders& occluders, std::span<const Pose> poses);

  const ProbeView& view(std::size_t object, int side) const {
    return views_[object][static_cast<std::size_t>(side)];
  }
  /// The vertices of an object that belong to a side, each with its weight.
  struct Belongs {
    std::uint32_t vertex;
    float weight;
  };
  std::span<const Belongs> vertices(std::size_t object, int side) const {
    return belongs_[object][static_cast<std::size_t>(side)];
  }
  /// Of the object as a whole, the mean over its sides.
  const BlockedSh& by_real(std::size_t object) const { return by_real_[object]; }

 private:
  void look_from(std::size_t object, const shadows::RayOccluders& occluders, const Pose& pose);
  ProbeView look_from_side(std::size_t object, int side, const shadows::RayOccluders& occluders,
                           const Pose& pose) const;

  const PreparedScene* scene_;
  std::vector<Pose> poses_;
  using Vertices = std::vector<std::uint32_t>;
  std::vector<std::array<Vertices, kProbeDirections>> vertices_;  // that belong to a side most
  std::vector<std::array<std::vector<Belongs>, kProbeDirections>> belongs_;
  std::vector<std::array<ProbeView, kProbeDirections>> views_;
  std::vector<BlockedSh> by_real_;
};

/// The light with the hidden directions replaced by an even radiance.
RadianceSh with_occluder_radiance(const RadianceSh& light, const BlockedSh& hidden,
                                  const Rgb& radiance);

/// Mean exit radiance of the surface elements that face `point`, weighted by the solid angle
/// in which they appear.
/// in: exit(i), radiance of vertex i
template <class Exit>
Rgb radiance_towards(const prt::Mesh& mesh, const Pose& world_from_mesh, const glm::dvec3& point,
                     Exit exit) {
  constexpr std::size_t kStep = 16;  // a sixteenth of the vertices is plenty for a mean
  const glm::vec3 there(world_from_mesh.inverse() * point);
  Rgb sum;
  float weight = 0;
  for (std::size_t i = 0; i < mesh.positions.size(); i += kStep) {
    const glm::vec3 d = there - mesh.positions[i];
    const float square = glm::dot(d, d) + 1e-12f,
                angle = glm::dot(mesh.normals[i], d) / (square * std::sqrt(square));
    if (angle <= 0) continue;
    sum += exit(i) * angle;
    weight += angle;
  }
  return weight > 0 ? sum * (1 / weight) : Rgb{};
}

}  // namespace penumbra::runtime
#pragma GCC visibility pop
