#include "runtime/pipeline/governor_config.h"

#include <algorithm>
#include <glm/geometric.hpp>
#include <vector>

#include "core/conventions.h"
#include "lighting/lights/distant_light.h"
#include "prt/bake/bake.h"
#include "prt/transfer/transfer.h"
#include "runtime/pipeline/single_thread_time.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/shading/direct_light_stage.h"
#include "runtime/shading/occlusion_probes.h"
#include "shadows/field/planar_shadow.h"

namespace penumbra::runtime {

namespace {

// An object with its planar shadow, as a stage relights them.
class Relit {
 public:
  explicit Relit(const PreparedObject& o)
      : baked_(o.baked),
        patterns_(o.baked),
        light_(3 * o.baked.transfer.stride),
        taken_(3 * o.baked.ground_deficit.stride) {}

  void relight(const RadianceSh& light, const RadianceSh* reflected) {
    patterns_.surface.relight(light, reflected, light_);
    const prt::Transfer& deficit = baked_.ground_deficit;
    if (!baked_.receiver || deficit.points == 0) return;
    patterns_.ground.relight(light, reflected, taken_);
    shadows::compose_planar_shadow({baked_.receiver->grid, deficit.bands, deficit.stride, taken_},
                                   light, shadow_);
  }

 private:
  const prt::BakedObject& baked_;
  RelightBases patterns_;
  std::vector<float> light_, taken_;
  shadows::PlanarShadow shadow_;
};

}  // namespace

lighting::ShadowProbes shadow_probes(const PreparedScene& scene) {
  lighting::ShadowProbes out;
  for (const PreparedObject& o : scene.objects)
    for (std::size_t p = 0; p < o.baked.shadow_probes.points; ++p)
      for (int n = 0; n < kMaxCoefficients; ++n)
        out.deficit.push_back(static_cast<float>(kPi) * o.baked.shadow_probes.value(0, n, p));
  return out;
}

Result<lighting::CostModel> fit_costs(const PreparedScene& scene) {
  PENUMBRA_ASSIGN(lights, DirectLightStage::create(scene, {}));
  const OcclusionProbes alone(
      scene);  // nothing looked at yet: what stands around costs the same for any plan
  lighting::CostModel costs;
  std::vector<Relit> things;
  for (const PreparedObject& o : scene.objects) things.emplace_back(o);
  const RadianceSh light(kMaxBands);
  const auto relight = [&](const RadianceSh* reflected) {
    const auto all = [&](int) {
      for (Relit& thing : things) thing.relight(light, reflected);
    };
    return time_single_threaded(5, all).p50_ms;
  };
  // What is baked is read whole, whatever the bands of the light; the first light brings reflected
  // light.
  costs.per_coefficient_ms = 0;
  costs.base_ms = relight(nullptr);
  const double reflected_ms = std::max(0., relight(&light) - costs.base_ms);
  lighting::DistantLight sun;
  sun.id = 1;
  sun.radius = Radians(.02);
  sun.radiance = {1, 1, 1};
  const auto move = [&](int run) {
    sun.direction = glm::normalize(glm::dvec3(1, 1.2, .3 + .1 * run));
    lights.update({&sun, 1}, 1, alone);
  };
  costs.per_light_ms = reflected_ms + time_single_threaded(3, move).p50_ms;
  return costs;
}

Result<lighting::GovernorConfig> make_governor_config(const PreparedScene& scene, double budget,
                                                      bool fitted) {
  lighting::GovernorConfig out;
  out.limits.budget = budget;
  out.probes = shadow_probes(scene);
  if (!fitted) return out;
  PENUMBRA_ASSIGN(costs, fit_costs(scene));
  out.costs = costs;
  return out;
}

}  // namespace penumbra::runtime
