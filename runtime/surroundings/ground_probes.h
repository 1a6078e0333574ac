// What stands behind and around each virtual object, as seen from points of the floor around it.
// Where a real thing stands behind the object, the object takes that thing's light from the floor
// and not the sky's; where one stands in view, the object has taken some of its light, too.
// threads: thread-bound, parallel inside
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "prt/rays/ray_pattern.h"
#include "runtime/scene/scene.h"
#include "runtime/surroundings/real_point.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::runtime {

/// A ray from the floor that meets the object, or something real past it.
struct GroundHit {
  std::uint16_t point = 0;
  bool bake_blocks = false;   // the object stands in this direction
  bool object_first = false;  // and no real thing before it
  bool inside = false;        // it is the back of the object that stands there
  bool real = false;          // something real is seen, or is behind the object; else the sky
  std::uint32_t vertex = 0;   // of the object, the nearest
  RealPoint at;               // of that
  glm::vec3 direction{0};     // unit, world
};

/// Points are even steps of the object's ground grid, which lie closer where the object is near.
class GroundProbes {
 public:
  static constexpr int kSize = 16, kPoints = kSize * kSize, kRays = 64;

  /// The scene must outlive it.
  explicit GroundProbes(const PreparedScene& scene);

  /// False on one plane without a real mesh: the sky is behind all objects.
  bool any() const { return !scene_->real_mesh.triangles.empty() || scene_->planes.size() > 1; }
  /// Casts rays where something moved; `other_form`: of an object, where poses do not tell.
  /// in: occluders as made for this scene
  /// floors: where the bake frames would be if the objects stood on their planes
  void update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
              std::span<const Pose> floors, bool other_form);
  void update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
              bool other_form) {
    update(occluders, poses, poses, other_form);
  }

  /// For an object of a scene where any() is false: casts its rays if it never did. In its own
  /// frame they meet the same wherever it stands; a clip's meet the form that it has then.
  void look_once(std::size_t object, const shadows::RayOccluders& occluders);

  /// As last looked at; each ray stands for 1/kRays of the irradiance over pi.
  std::span<const GroundHit> hits(std::size_t object) const { return objects_[object].hits; }
  /// Where a point lies, world.
  glm::dvec3 place(std::size_t object, std::size_t point) const;
  /// Adds values of an object's points to those of its ground grid's texels, bilinear, a plane for
  /// each colour. Points within or behind real things do not count.
  /// in: out of 3 strides, size^2 texels of each used
  void spread(std::size_t object, std::span<const Rgb, kPoints> of_points, int size,
              std::span<float> out) const;

 private:
  struct GroundObject {
    std::vector<GroundHit> hits;
    std::array<bool, kPoints> open{};  // lies before what is real
    bool looked = false;
  };
  void look_from(std::size_t object, const shadows::RayOccluders& occluders);
  void look_from_row(std::size_t object, int row, const shadows::RayOccluders& occluders);

  const PreparedScene* scene_;
  prt::RayPatterns patterns_{kRays};
  std::vector<Pose> poses_, floors_;
  std::array<std::vector<GroundHit>, kSize> rows_;  // of one object
  std::vector<GroundObject> objects_;
};

}  // namespace penumbra::runtime
