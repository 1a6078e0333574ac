// What stands around each virtual object: the directions that other objects and real geometry hide from it, and
// how brightly they shine there instead. Low frequencies alone; discs have their own rays.
// threads: thread-bound
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/pose.h"
#include "core/sh.h"
#include "service/scene.h"
#include "shadows/shadows.h"

namespace penumbra::service {

/// b_n = Int (share of the surface that sees something else there) Y_n dw, world frame.
struct Hidden {
  std::array<float, shadows::kMaxFieldBands * shadows::kMaxFieldBands> blocked{};
  float share = 0;  // of the sphere
};

/// An object has six sides, +x -x +y -y +z -z of its bake frame: a normal n belongs to that of axis k by n_k^2.
inline constexpr int kSides = 6;
inline float belongs_to(const glm::vec3& normal, int side) {
  const float n = normal[side / 2];
  return (n > 0) == (side % 2 == 0) ? n * n : 0;
}

/// What one side of an object sees of other things.
struct SideView {
  Hidden by_real, by_virtual;
};

class Surroundings {
 public:
  /// The scene must outlive it.
  explicit Surroundings(const PreparedScene& scene);

  /// False for an object alone: nothing needs to be looked at.
  bool any() const { return scene_->objects.size() > 1 || !scene_->real_mesh.triangles.empty(); }

  /// Looks around from every object, with rays from all over its surface that it does not block itself. The same again
  /// when nothing has moved costs nothing.
  /// in:  blockers as made for this scene (as DiscStage::blockers)
  void look(const shadows::Blockers& blockers, std::span<const Pose> poses);

  const SideView& view(std::size_t object, int side) const {
    return views_[object][static_cast<std::size_t>(side)];
  }
  /// Of the object as a whole, the mean over its sides.
  const Hidden& by_real(std::size_t object) const { return by_real_[object]; }

 private:
  void look_from(std::size_t object, const shadows::Blockers& blockers, const Pose& pose);
  SideView look_from_side(std::size_t object, int side, const shadows::Blockers& blockers,
                          const Pose& pose) const;

  const PreparedScene* scene_;
  std::vector<Pose> poses_;
  using Vertices = std::vector<std::uint32_t>;
  std::vector<std::array<Vertices, kSides>> vertices_;  // that belong to a side most
  std::vector<std::array<SideView, kSides>> views_;
  std::vector<Hidden> by_real_;
};

/// The light with the hidden directions replaced by an even radiance.
RadianceSh seen_behind(const RadianceSh& light, const Hidden& hidden, const Rgb& radiance);

/// Mean exit radiance of the surface elements that face `point`, weighted by their cosine.
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
    const float cosine = glm::dot(mesh.normals[i], d) / (glm::length(d) + 1e-20f);
    if (cosine <= 0) continue;
    sum += exit(i) * cosine;
    weight += cosine;
  }
  return weight > 0 ? sum * (1 / weight) : Rgb{};
}

}  // namespace penumbra::service
