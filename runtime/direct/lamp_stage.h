// The light of a scene's virtual lamps and luminous objects on objects, planes and real meshes;
// traced when something moved.
// threads: thread-bound, parallel inside
#pragma once

#include <span>
#include <vector>

#include "compositor/composite/compositor.h"
#include "prt/geometry/luminous.h"
#include "runtime/scene/scene.h"
#include "shadows/silhouette/occluders.h"
#include "shadows/silhouette/shadow_map.h"

namespace penumbra::runtime {

class LampStage {
 public:
  /// The scene must outlive the stage.
  explicit LampStage(const PreparedScene& scene);

  bool any() const { return !traced_.empty(); }
  /// One that is not visible lights nothing. All are visible at first.
  void show(std::size_t object, bool visible) { visible_[object] = visible; }
  /// emission_unit: radiance that an emission of 1 has
  /// True when anything changed: at first, when an object has moved or taken another form, and when
  /// the unit is half a percent another where something is luminous.
  bool update(const shadows::RayOccluders& occluders, std::span<const Pose> poses, bool other_form,
              float emission_unit);

  /// Adds to exit radiance for a unit albedo, in prt::relight's layout.
  void add_light(std::size_t object, std::span<float> relit) const;
  /// At the vertices of the real mesh, beside everything else; empty without lamps or mesh.
  std::span<const Rgb> on_real_mesh() const { return on_real_mesh_; }
  /// Appends what lamps add to every plane, as shadows of negative part; `open_irradiance[p]` as
  /// DirectLightStage::shadows.
  void append(std::span<const Rgb> open_irradiance,
              std::vector<compositor::ShadowMapOnPlane>& out) const;

 private:
  // A lamp, or a luminous part of an object.
  struct TracedLamp {
    const shadows::Lamp* lamp;
    std::size_t object;  // that it is a part of
    const prt::LuminousPart* part;
    std::vector<std::vector<float>> on_object{};  // by vertex
    std::vector<shadows::ShadowMap> on_plane{};
    std::vector<float> brightest{};  // by plane
    std::vector<float> on_real{};    // by vertex
  };
  Rgb power(const TracedLamp& t) const;
  void trace(const shadows::RayOccluders& occluders, TracedLamp& t) const;
  void sum_on_real_mesh();

  const PreparedScene* scene_;
  std::vector<char> visible_;
  std::vector<Pose> poses_;
  bool known_ = false, luminous_ = false;
  float emission_unit_ = 0;
  std::vector<TracedLamp> traced_;
  std::vector<Rgb> on_real_mesh_;
};

}  // namespace penumbra::runtime
