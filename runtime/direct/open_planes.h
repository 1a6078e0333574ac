// The light of real planes without objects and real meshes.
// threads: thread-bound
#pragma once

#include <span>
#include <vector>

#include "core/image.h"
#include "core/pose.h"
#include "lighting/light_estimate.h"
#include "prt/bake/bake.h"
#include "runtime/scene/scene.h"
#include "runtime/surroundings/plane_exchange.h"

namespace penumbra::runtime {

class OpenPlanes {
 public:
  /// The scene must outlive it.
  explicit OpenPlanes(const PreparedScene& scene);

  void update(const lighting::LightEstimate& light);
  /// Irradiance of each, distant lights included as if nothing kept them off; at least a small part
  /// of what it would be if it were the only plane.
  std::span<const Rgb> irradiance() const { return irradiance_; }
  /// What the other planes change in that.
  const Rgb& change(std::size_t plane) const { return changes_[plane]; }
  /// Of the plane that a thing stands on; none: no change.
  Rgb change_under(const prt::BakedObject& baked, const Pose& world_from_bake) const;

 private:
  const PreparedScene* scene_;
  PlaneExchange exchange_;
  std::vector<const RadianceSh*> residuals_;  // scratch, by plane
  std::vector<Rgb> irradiance_, changes_;
};

}  // namespace penumbra::runtime
