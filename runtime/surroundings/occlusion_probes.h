// What stands around each virtual object, as seen from points all over its surface: real meshes,
// other objects, and the floor that things shade. Lights have their own rays.
// threads: thread-bound, parallel inside
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <optional>
#include <span>
#include <vector>

#include "core/pose.h"
#include "prt/rays/ray_pattern.h"
#include "runtime/scene/scene.h"
#include "runtime/surroundings/real_point.h"
#include "shadows/silhouette/occluders.h"

namespace penumbra::runtime {

/// A direction, of OcclusionProbes::kSphereRays even ones, in which something real hides the sky
/// from an object. The floor that the object stands on does not count.
struct RealHit {
  glm::vec3 direction;  // unit, world
  RealPoint at;
};

/// Where a ray of a probe ends, if not in the open sky. Each probe itself is one more, without
/// weight.
struct ProbeHit {
  enum Thing : std::int16_t { kProbe = -4, kItself = -3, kFloor = -2, kReal = -1 };

  std::uint16_t probe;
  std::int16_t thing;    // a Thing, or the number of another object
  bool above_floor;      // the bake counted on the floor in this direction
  std::uint32_t vertex;  // of the virtual thing's mesh, the nearest
  glm::vec3 direction;   // unit, world
  glm::vec3 point;       // world: where the ray meets or would meet the floor
  RealPoint real{};      // of a kReal
};

/// A ray of a probe that ends in the open sky.
struct OpenRay {
  std::uint16_t probe;
  glm::vec3 direction;  // unit, world
};

/// Probes are vertices, apart in place and normal, each with rays by the cosine. Every vertex lies
/// between the nearest of them. The first few of them lie all over the object, too: those alone
/// look around while anything moves, with fewer rays.
class OcclusionProbes {
 public:
  static constexpr int kFewProbes = 256, kProbes = 1024, kRays = 32, kFineRays = 128, kNearest = 8,
                       kSphereRays = 256;
  static constexpr std::size_t kMaxHits = kProbes * (kFineRays + 1);  // of an object
  static constexpr int kStillFrames = 8;  // what is dragged moves in steps

  /// The scene must outlive it.
  explicit OcclusionProbes(const PreparedScene& scene);

  /// False for an object alone on one plane: nothing needs to be looked at.
  bool any() const { return scene_->objects.size() > 1 || any_real(); }

  /// Looks around from what has moved, and from what sees a good deal of it. What sees little of
  /// it waits, for its turn or until that has come to a visible change. Once all have looked, the
  /// same again costs nothing.
  /// floors: where the bake frames would be if the objects stood on their planes
  /// in:  occluders as made for this scene (as DirectLightStage::occluders)
  void update(const shadows::RayOccluders& occluders, std::span<const Pose> poses,
              std::span<const Pose> floors);
  void update(const shadows::RayOccluders& occluders, std::span<const Pose> poses) {
    update(occluders, poses, poses);
  }

  /// An object in deep shade asks for all probes: what little light reaches it comes from a small
  /// part of what is around, which the next probe may not see.
  void want_fine(std::size_t object, bool wants) { objects_[object].wants_fine = wants; }
  /// Once a frame, after update(): when nothing has moved for kStillFrames, or `at_once`, looks
  /// again from objects that ask for all probes. True where one did.
  bool refine(const shadows::RayOccluders& occluders, bool at_once = false);

  /// As last looked at; rays of weight 1/rays().
  std::span<const ProbeHit> hits(std::size_t object) const { return objects_[object].hits; }
  bool is_fine(std::size_t object) const { return objects_[object].is_fine; }
  int rays(std::size_t object) const { return is_fine(object) ? kFineRays : kRays; }
  /// Of some probes all hits and open rays, from the first to before the last.
  struct ProbePart {
    std::size_t first_hit, last_hit, first_open, last_open;
  };
  std::span<const ProbePart> parts(std::size_t object) const { return objects_[object].parts; }
  /// Another number each time that the hits are others.
  std::uint32_t hits_version(std::size_t object) const { return objects_[object].hits_version; }
  /// True where there is anything real but one plane.
  bool any_real() const {
    return !scene_->real_mesh.triangles.empty() || scene_->planes.size() > 1;
  }
  /// Of an object that real things hide something of the sphere from; else empty.
  std::span<const OpenRay> open_rays(std::size_t object) const { return objects_[object].open; }
  using Values = std::array<float, kProbes>;
  /// out[v] += what the probes around vertex v have, a plane for each colour.
  void spread(std::size_t object, std::span<const Rgb> of_probes, std::span<float> out) const;
  /// out[v] -= (1 - part/whole) in[v] around vertex v, a plane for each colour; nothing where the
  /// whole is 0.
  void take_missing(std::size_t object, const Values& part, const Values& whole,
                    std::span<const float> in, std::span<float> out) const;
  /// What the probes around a vertex have.
  Rgb at_vertex(std::size_t object, std::span<const Rgb> of_probes, std::size_t vertex) const;
  /// in[v], which is a part of out[v], becomes a blend of what is left of it, lit in[v] with
  /// lit = part/whole around vertex v, and of what was gathered there: the former where most is
  /// left, the latter where little is. A plane for each colour.
  void replace_shaded(std::size_t object, const Values& part, const Values& whole,
                      std::span<const Rgb> gathered, std::span<const float> in,
                      std::span<float> out) const;
  /// Of the object as a whole.
  std::span<const RealHit> by_real(std::size_t object) const { return objects_[object].by_real; }
  /// Around the object in its first form, bake frame, metres.
  const glm::vec3& centre(std::size_t object) const { return objects_[object].centre; }
  float radius(std::size_t object) const { return objects_[object].radius; }
  /// Vertices of the object that are its probes.
  std::span<const std::uint32_t> probes(std::size_t object) const {
    return objects_[object].probes;
  }

 private:
  struct Nearby {
    std::array<std::uint16_t, kNearest> probe;
    std::array<float, kNearest> weight;
  };
  static constexpr std::size_t kPerBlock = 32;  // probes that one thread looks from
  struct ProbeBlock {
    std::vector<ProbeHit> hits;
    std::vector<OpenRay> open;
  };
  struct Object {
    std::vector<std::uint32_t> probes;  // vertices
    // By vertex, of the few and of all
    std::array<std::vector<Nearby>, 2> nearby_of;
    glm::vec3 centre{0};  // bake frame, in its first form
    float radius = 0;
    std::vector<ProbeBlock> blocks;
    std::vector<ProbeHit> hits;
    std::vector<ProbePart> parts;
    std::vector<OpenRay> open;
    std::vector<RealHit> by_real;
    bool is_fine = false, wants_fine = false;
    std::uint32_t hits_version = 0;
    double missed = 0;  // of its view, what has changed since it looked
    const std::vector<Nearby>& nearby() const { return nearby_of[is_fine]; }
    std::span<const std::uint32_t> used_probes(bool fine) const {
      return std::span(probes).first(fine ? probes.size()
                                          : std::min<std::size_t>(kFewProbes, probes.size()));
    }
  };
  struct Surroundings;
  struct Met;
  struct Other;
  static std::optional<ProbeHit> hit_of(const Met& met, int lane, std::size_t probe,
                                        const Surroundings& in);
  static std::optional<float> left_at(const Nearby& nearby, const Values& part,
                                      const Values& whole);
  double swept(std::size_t index, std::size_t moved, const Pose& before) const;
  void look_from(std::size_t index, const shadows::RayOccluders& occluders);
  void look_from_block(Object& object, std::size_t block, const Surroundings& in) const;

  const PreparedScene* scene_;
  prt::RayPatterns patterns_{kRays}, fine_patterns_{kFineRays};
  std::vector<Pose> poses_, poses_before_, floors_;
  int still_frames_ = 0;
  std::vector<Object> objects_;
};

}  // namespace penumbra::runtime
