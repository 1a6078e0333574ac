// The light of a scene's virtual lamps on objects, planes and real meshes; traced when something
// moved.
// threads: thread-bound, parallel inside
#pragma once

#include <span>
#include <vector>

#include "compositor/composite/compositor.h"
#include "runtime/scene/scene.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/shadow_map.h"

namespace penumbra::runtime {

class LampStage {
 public:
  /// The scene must outlive the stage.
  explicit LampStage(const PreparedScene& scene) : scene_(&scene), traced_(scene.lamps.size()) {}

  bool any() const { return !traced_.empty(); }
  /// True when anything was traced: at first, and when an object has moved or taken another form.
  bool update(const shadows::RayOccluders& occluders, std::span<const Pose> poses, bool other_form);

  /// Adds to exit radiance for a unit albedo, in prt::relight's layout.
  void add_light(std::size_t object, std::span<float> relit) const;
  /// At the vertices of the real mesh, beside everything else; empty without lamps or mesh.
  std::span<const Rgb> on_real_mesh() const { return on_real_mesh_; }
  /// Appends what lamps add to every plane, as shadows of negative part; `open_irradiance[p]` as
  /// DirectLightStage::shadows.
  void append(std::span<const Rgb> open_irradiance,
              std::vector<compositor::ShadowMapOnPlane>& out) const;

 private:
  struct TracedLamp {
    std::vector<std::vector<float>> on_object;  // by vertex
    std::vector<shadows::ShadowMap> on_plane;
    std::vector<float> brightest;  // by plane
  };
  const PreparedScene* scene_;
  std::vector<Pose> poses_;
  bool known_ = false;
  std::vector<TracedLamp> traced_;
  std::vector<Rgb> on_real_mesh_;
};

}  // namespace penumbra::runtime
