// Paths through a reference world.
// threads: reentrant once made
#pragma once

#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "prt/geometry/local_material.h"
#include "prt/geometry/plane.h"
#include "prt/rays/rays.h"
#include "prt/reference/internal/path_numbers.h"
#include "prt/reference/materials.h"
#include "prt/reference/reference.h"

namespace penumbra::prt {

/// Where a path goes on.
struct PathPoint {
  glm::vec3 position{}, normal{};           // the normal on the side that is seen
  Rgb albedo{};                             // with a material: how much of what it sends counts
  std::optional<LocalMaterial> material{};  // nothing: Lambertian
};

class Tracer {
 public:
  /// The world must outlive it.
  /// errors: kInvalid (world), kUnavailable (Embree)
  static Result<Tracer> make(const ReferenceWorld& world, int longest_path);

  /// One sample of E/pi at a Lambertian point, or of what one with a material sends to the viewer.
  Rgb gather(const PathPoint& start, const glm::vec3& towards_viewer, PathNumbers& numbers) const;
  Rgb seen_from_camera(const glm::vec3& o, const glm::vec3& d, PathNumbers& numbers) const;

 private:
  enum class Meeting { kNothing, kSurface, kBack };
  /// How a path goes on from a point.
  struct PathStep {
    glm::vec3 direction{};
    Rgb weight{1, 1, 1};
    float density = 0;  // 0: it ends
  };

  Tracer(const ReferenceWorld& world, int longest_path)
      : world_(world), longest_path_(longest_path) {}
  Meeting trace(const glm::vec3& o, const glm::vec3& d, float near, PathNumbers& numbers,
                PathPoint& out) const;
  Meeting meet_triangle(const Hit& hit, const glm::vec3& o, const glm::vec3& d,
                        PathPoint& out) const;
  const Material* material_of(const Hit& hit) const;
  TrianglePlace place_of(const Hit& hit) const;
  float cover(const Hit& hit, const glm::vec3& d) const;
  /// Of the light that comes along a ray: 0 where something is in the way.
  float open_fraction(const glm::vec3& o, const glm::vec3& d, float far = 1e30f) const;
  const Plane* nearest_plane(const glm::vec3& o, const glm::vec3& d, float near,
                             float& distance) const;
  Rgb direct(const PathPoint& at, const MaterialLobes* lobes, PathNumbers& numbers) const;
  Rgb from_lamp(const SphereLight& lamp, const PathPoint& at, const MaterialLobes* lobes,
                PathNumbers& numbers) const;
  PathStep step(const PathPoint& at, const MaterialLobes* lobes, PathNumbers& numbers) const;

  const ReferenceWorld& world_;
  int longest_path_;
  std::shared_ptr<const RayScene> scene_;
  bool see_through_ = false;  // some material
  float near_ = 1e-4f;
};

}  // namespace penumbra::prt
