// What objects with materials mirror of a light estimate.
// threads: thread-bound
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "compositor/composite/compositor.h"
#include "compositor/surroundings.h"
#include "lighting/light_estimate.h"
#include "lighting/reflections/reflection_map.h"
#include "runtime/direct/direct_light_stage.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {

class MirroredSurroundings {
 public:
  explicit MirroredSurroundings(const PreparedScene& scene);

  bool any() const { return !asked_.empty(); }
  /// Hands on what changed. An estimate without reflections is mirrored as its harmonics say.
  /// handles: of the objects, in the compositor
  void update(const lighting::LightEstimate& light, const DirectLightStage& lights,
              const std::vector<int>& handles, compositor::Compositor& compositor);

 private:
  bool is_shown(const lighting::LightEstimate& light) const;
  compositor::Surroundings surroundings_of(const lighting::LightEstimate& light);
  std::shared_ptr<const lighting::ReflectionMap> from_harmonics(const RadianceSh& light);

  const PreparedScene& scene_;
  lighting::SurfaceRoughness asked_;
  std::optional<lighting::ReflectionFilter> own_filter_;  // of estimates without reflections
  std::optional<lighting::LightEstimate> shown_;
  std::vector<std::array<float, 4>> fractions_;  // scratch, of one object's vertices
  std::vector<float> one_;                       // of one light
};

}  // namespace penumbra::runtime
