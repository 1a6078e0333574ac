// Direct light and shadows of lights in a scene: traced when a light or an object moved, else kept.
// threads: thread-bound, parallel inside
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "compositor/composite/compositor.h"
#include "core/result.h"
#include "lighting/lights/distant_light.h"
#include "prt/geometry/mesh.h"
#include "prt/rays/rays.h"
#include "prt/transfer/visibility_map.h"
#include "runtime/scene/scene.h"
#include "runtime/scene/shadow_sampling.h"
#include "runtime/surroundings/occlusion_probes.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/shadow_map.h"
#include "shadows/silhouette/silhouette_cache.h"
#include "shadows/silhouette/silhouette_mesh.h"
#include "shadows/visibility/direct_light.h"

namespace penumbra::runtime {

class DirectLightStage {
 public:
  /// The scene must outlive the stage.
  /// errors: kUnavailable (Embree)
  static Result<DirectLightStage> create(const PreparedScene& scene,
                                         const ShadowSampling& sampling);

  /// world_from_floor: where the bake frame would be if it stood on its plane
  void set_pose(std::size_t object, const Pose& world_from_bake, const Pose& world_from_floor);
  void set_pose(std::size_t object, const Pose& world_from_bake) {
    set_pose(object, world_from_bake, world_from_bake);
  }
  /// One that is not visible is not lit, and its pose must keep it out of all light. All are
  /// visible at first.
  void show(std::size_t object, bool visible) { visible_[object] = visible; }
  /// Real things that pass by, in the world frame, in the place of those before: they throw shadows
  /// of the lights on objects, and where theirs are on a plane the objects' take no more. None: a
  /// mesh without triangles.
  /// errors: kUnavailable (Embree)
  Result<void> set_passing(prt::Mesh mesh);
  bool any_passing() const { return !passing_mesh_.triangles.empty(); }
  /// Around each object as it stands.
  std::vector<shadows::BoundingSphere> spheres() const;
  /// Follows the mesh of an object that moves by itself.
  void update_vertices(std::size_t object);
  /// Brings everything up to date with the lights and with what stands around. True when anything
  /// was traced or a radiance changed visibly, relative to `mean_irradiance`. `open_irradiance[p]`
  /// is the light of open plane p, lights included: shadows of what brings little of it are drawn
  /// less finely; none: all finely.
  /// The first `fine_lights` cast finely drawn shadows on planes. Of the others narrow ones cast
  /// coarse ones; wide ones are drawn by what they bring anyway.
  bool update(std::span<const lighting::DistantLight> lights, double mean_irradiance,
              const OcclusionProbes& around, std::span<const Rgb> open_irradiance = {},
              std::size_t fine_lights = kAllLights);
  static constexpr std::size_t kAllLights = std::numeric_limits<std::size_t>::max();
  /// Whether the last update() changed what an object gets of the lights, or reflects of them.
  bool changed(std::size_t object) const { return changed_[object] != 0; }

  /// Mesh i of virtual_things is object i. Of real_things the real mesh is the first, where there
  /// is one; planes follow, where there are several.
  shadows::RayOccluders occluders() {
    follow_forms();
    return rays();
  }
  /// What keeps a distant light (by its place in update()'s list) from the points of an object's
  /// probe hits.
  enum HitShade : std::uint8_t { kNone = 0, kByItself = 1, kByOthers = 2 };
  std::span<const std::uint8_t> hit_shade(std::size_t source, std::size_t object) const {
    return traced_[source].hit_shade[object];
  }

  /// As it is now; what was traced may be for one that is less than a visible move away.
  const glm::dvec3& direction(std::size_t source) const { return traced_[source].source.direction; }

  /// Adds the lights' direct light to exit radiance for a unit albedo, in prt::relight's layout.
  void add_light(std::size_t object, std::span<float> relit) const;
  /// Of what add_light() adds, the light whose shadow on the object is drawn finer than its mesh.
  std::optional<compositor::EdgedLight> edged_light(std::size_t object) const;
  /// What of a light (by its place in update()'s list) comes to each vertex of an object, 0..1.
  /// Where the surface looks away from it: to its other side, of what is double-sided; else 1.
  void visible_fractions(std::size_t source, std::size_t object, std::span<float> out) const;
  /// E0 - E at points of real geometry and what is really left there of all distant lights,
  /// relative irradiance.
  struct AtVertices {
    std::vector<Rgb> open, virtual_occlusion, real_occlusion;
  };
  AtVertices at_vertices(const prt::Mesh& mesh) const;

  /// The shadows on every plane; `open_irradiance[p]` is the light of open plane p, lights
  /// included.
  void shadows(std::span<const Rgb> open_irradiance,
               std::vector<compositor::ShadowMapOnPlane>& out) const;

 private:
  // Of all sources: the mean over normals, and on planes (none: not known).
  struct OpenLight {
    double mean_irradiance;
    std::span<const Rgb> on_planes;
  };
  // How finely a light is traced, by what it brings.
  struct TracedDetail {
    int object_samples = 0;
    double plane = 0;  // ShadowMapOptions::resolution_scale
    bool fine = false;
  };
  struct TracedLight {
    TracedDetail detail;            // as it was traced
    lighting::DistantLight source;  // as it is now
    lighting::DistantLight as_traced;
    std::vector<std::vector<float>> cosine;      // by object, by vertex
    std::vector<std::uint8_t> hurried;           // by object: 0, or updates until it is traced well
    std::vector<shadows::EdgedFractions> edged;  // by object
    std::vector<std::vector<std::uint8_t>> hit_shade;       // by object, by probe hit
    std::vector<std::uint32_t> hits_version;                // by object: of the hits that it shades
    std::vector<std::vector<shadows::ShadowMap>> on_plane;  // by plane, by group of objects
    std::vector<shadows::ShadowMap> real_on_plane;          // by plane; empty without real things
  };
  DirectLightStage(const PreparedScene& scene, const ShadowSampling& sampling,
                   prt::RayWorld virtual_things, prt::RayWorld real_things)
      : scene_(&scene),
        sampling_(sampling),
        virtual_(std::move(virtual_things)),
        real_(std::move(real_things)) {}
  void fractions_of_backs(const lighting::DistantLight& source, std::size_t object, float grazing,
                          std::span<float> out) const;
  shadows::RayOccluders rays() const { return {&virtual_, &real_, near_m_}; }
  shadows::RayOccluders all_rays() const {
    return {&virtual_, &real_, near_m_, passing_ ? &*passing_ : nullptr};
  }
  shadows::ShadowCasters casters() { return {virtual_casters_, real_casters_, near_m_, &memo_}; }
  void keep_passing_out();
  Result<void> add_object(const PreparedObject& object);
  Result<void> add_real_mesh();
  void add_caster(const prt::Mesh& mesh, const Pose& pose, std::vector<shadows::Caster>& to);
  float smallest_radius() const;  // of the objects, of which there is one
  /// Building a moved mesh for rays takes a millisecond, which a frame without lights need not
  /// spend.
  void follow_forms();
  /// True where something that was hurried is due to be traced well.
  bool settle(TracedLight& traced) const;
  /// `all`: the light itself is new or has moved; otherwise only what objects that moved can have
  /// changed.
  void trace(TracedLight& traced, bool all);
  bool shade_new_hits(TracedLight& traced, const OcclusionProbes& around, bool all);
  void trace_planes(TracedLight& traced);
  TracedDetail detail_for(const lighting::DistantLight& source, bool fine, const OpenLight& open,
                          const TracedDetail& before) const;
  bool may_have_changed(std::size_t object, const lighting::DistantLight& source) const;
  void shade_hits(std::size_t object, const lighting::DistantLight& source,
                  const OcclusionProbes& around, std::vector<std::uint8_t>& out) const;

  const PreparedScene* scene_;
  ShadowSampling sampling_;
  prt::RayWorld virtual_, real_;
  std::optional<prt::RayWorld> passing_;  // once anything passed
  prt::Mesh passing_mesh_;
  shadows::SilhouetteMesh passing_silhouette_;
  // Where it was at the last update, and is now, since the last update
  std::vector<shadows::BoundingSphere> passed_;
  // By object: neither rays nor silhouettes know its present mesh yet
  std::vector<char> other_form_;
  std::vector<Pose> poses_, floors_;  // by object
  std::vector<char> visible_;
  std::vector<char> changed_;  // by object, see changed()
  std::vector<TracedLight> traced_, before_;
  std::optional<int> with_edges_;  // the light, by its id, whose shadows' edges are looked for
  std::vector<prt::Mesh> quads_;   // as much of each plane as a shadow can come from
  std::vector<shadows::SilhouetteMesh> silhouettes_;  // of the objects, then of real things
  std::vector<shadows::SilhouetteMesh> coarse_;       // of those that keep their form
  std::vector<prt::VisibilityLookup> visibilities_;   // of those of which it was baked
  std::vector<shadows::Caster> virtual_casters_, real_casters_;
  // What planes get shadows from, coarse where that is known: under lights that are not wide, and
  // that are. Of real things, by plane, all but the plane itself.
  std::array<std::vector<shadows::Caster>, 2> virtual_on_planes_;
  std::vector<std::vector<shadows::Caster>> real_on_;
  std::vector<shadows::Neighbourhood> around_;
  shadows::SilhouetteCache memo_;                 // of the light that is traced
  std::vector<shadows::BoundingSphere> spheres_;  // around the objects, bake frame
  std::vector<std::optional<Pose>> moved_from_;   // by object, since the last update
  float near_m_ = 1e-4f;
};

}  // namespace penumbra::runtime
