// What stands around each virtual object, as seen from points all over its surface: real meshes,
// other objects, and the floor that things shade. Lights have their own rays.
// threads: thread-bound
#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/pose.h"
#include "core/sh.h"
#include "prt/geometry/ray_pattern.h"
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

/// Where a ray of a probe ends, if not in the open sky. Each probe itself is one more, without
/// weight.
struct ProbeHit {
  enum Thing : std::int16_t { kProbe = -4, kItself = -3, kFloor = -2, kReal = -1 };

  std::uint16_t probe;
  std::int16_t thing;    // a Thing, or the number of another object
  bool above_floor;      // the bake counted on the floor in this direction
  std::uint32_t vertex;  // of the thing's mesh, the nearest
  glm::vec3 direction;   // unit, world
  glm::vec3 point;       // world: where the ray meets or would meet the floor
};

/// Probes are vertices, apart in place and normal, each with rays by the cosine. Every vertex lies
/// between the nearest of them.
class OcclusionProbes {
 public:
  static constexpr int kProbes = 64, kRays = 64, kNearest = 4;
  static constexpr std::size_t kMaxHits = kProbes * (kRays + 1);  // of an object

  /// The scene must outlive it.
  explicit OcclusionProbes(const PreparedScene& scene);

  /// False for an object alone on one plane: nothing needs to be looked at.
  bool any() const {
    return scene_->objects.size() > 1 || !scene_->real_mesh.triangles.empty() ||
           scene_->planes.size() > 1;
  }

  /// Looks around from every object. The same again when nothing has moved costs nothing.
  /// in:  occluders as made for this scene (as DirectLightStage::occluders)
  void look(const shadows::RayOccluders& occluders, std::span<const Pose> poses);

  /// As last looked at; rays of weight 1/kRays.
  std::span<const ProbeHit> hits(std::size_t object) const { return objects_[object].hits; }
  using Values = std::array<float, kProbes>;
  /// out[v] += what the probes around vertex v have, a plane for each colour.
  void spread(std::size_t object, std::span<const Rgb> of_probes, std::span<float> out) const;
  /// out[v] -= (1 - part/whole) in[v] around vertex v, a plane for each colour; nothing where the
  /// whole is 0.
  void take_missing(std::size_t object, const Values& part, const Values& whole,
                    std::span<const float> in, std::span<float> out) const;
  /// Of the object as a whole.
  const BlockedSh& by_real(std::size_t object) const { return objects_[object].by_real; }

 private:
  struct Nearby {
    std::array<std::uint16_t, kNearest> probe;
    std::array<float, kNearest> weight;
  };
  struct Object {
    std::vector<std::uint32_t> probes;  // vertices
    std::vector<Nearby> nearby;         // by vertex
    std::vector<ProbeHit> hits;
    BlockedSh by_real;
  };
  struct Surroundings;
  struct Met;
  static std::optional<ProbeHit> hit_of(const Met& met, int lane, std::size_t probe,
                                        const Surroundings& in);
  void look_from(std::size_t index, const shadows::RayOccluders& occluders, const Pose& pose);

  const PreparedScene* scene_;
  prt::RayPatterns patterns_{kRays};
  std::vector<Pose> poses_;
  std::vector<Object> objects_;
};

/// The light with the hidden directions replaced by an even radiance.
RadianceSh with_occluder_radiance(const RadianceSh& light, const BlockedSh& hidden,
                                  const Rgb& radiance);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
