// What objects with materials mirror of a light estimate.
// threads: thread-bound
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
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
  /// out: whether anything did
  bool update(const lighting::LightEstimate& light, const DirectLightStage& lights,
              const std::vector<int>& handles, compositor::Compositor& compositor);

  /// Of the last update: what is mirrored, and of each object's vertices what comes to them of each
  /// light; none: all.
  const compositor::Surroundings& now() const { return now_; }
  std::span<const std::vector<std::array<float, 4>>> fractions() const { return fractions_; }

 private:
  bool is_shown(const lighting::LightEstimate& light) const;
  compositor::Surroundings surroundings_of(const lighting::LightEstimate& light);
  std::shared_ptr<const lighting::ReflectionMap> from_harmonics(const RadianceSh& light);

  const PreparedScene& scene_;
  lighting::SurfaceRoughness asked_;
  std::optional<lighting::ReflectionFilter> own_filter_;  // of estimates without reflections
  std::optional<lighting::LightEstimate> shown_;
  compositor::Surroundings now_;
  std::vector<std::vector<std::array<float, 4>>> fractions_;  // by object
  std::vector<float> one_;                                    // scratch, of one light
};

}  // namespace penumbra::runtime
