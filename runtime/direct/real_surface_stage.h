// Real meshes: what light really arrives on them and on the floor past them, what of it goes on to
// objects, and what virtual things take.
// threads: thread-bound, parallel inside
#pragma once

#include <span>
#include <vector>

#include "lighting/light_estimate.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/direct/lamp_stage.h"
#include "runtime/scene/scene.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::runtime {

/// Exit radiance over that of a plane, 0.01..100. Black stands for a plane of which nobody knows
/// it: then over the mean of all.
std::vector<Rgb> weights_beside(const Rgb& plane_radiance, std::span<const Rgb> exit);

class RealSurfaceStage {
 public:
  /// The scene must outlive the stage.
  explicit RealSurfaceStage(const PreparedScene& scene);

  /// False where no object can meet the light of a real mesh.
  bool any() const { return scene_->real != nullptr; }

  /// Renews what depends on the light where that changed visibly, or `lights_changed`. True when it
  /// did.
  bool measure(const lighting::LightEstimate& light, const DirectLightStage& lights,
               bool lights_changed);

  /// Exit radiance of the real mesh's vertices as last measured.
  std::span<const Rgb> exit() const { return exit_; }
  /// What the real mesh takes of the floor's light beside the lights; null where it stands on no
  /// plane.
  const shadows::PlanarShadow* shadow() const { return shadow_.ratio.empty() ? nullptr : &shadow_; }

  /// Ratios at the vertices: s = 1 - (what virtual things change)/(what really arrives).
  /// in: lost, irradiance/pi of the vertices without that of lights, negative where virtual things
  /// send more than they take
  std::vector<Rgb> ratios(const lighting::LightEstimate& light, std::span<const Rgb> lost,
                          const LampStage& lamps) const;

 private:
  void relight(const lighting::LightEstimate& light);

  const PreparedScene* scene_;
  RadianceSh measured_;                  // the light, without lights
  DirectLightStage::AtVertices lights_;  // at the vertices
  std::vector<Rgb> arrives_, exit_;      // irradiance and radiance of the vertices
  std::vector<float> relit_, reflected_;
  shadows::PlanarShadow shadow_;
};

}  // namespace penumbra::runtime
