#include "runtime/direct/real_surface_stage.h"

#include <algorithm>
#include <cmath>

#include "core/conventions.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/relight.h"
#include "prt/transfer/transfer.h"
#include "runtime/direct/scene_light.h"

namespace penumbra::runtime {

std::vector<Rgb> weights_beside(const Rgb& plane_radiance, std::span<const Rgb> exit) {
  constexpr float kRange = 100;
  Rgb whole = plane_radiance;
  if (!(luminance(plane_radiance) > 0)) {
    whole = {};
    for (const Rgb& radiance : exit) whole += radiance * (1 / static_cast<float>(exit.size()));
  }
  std::vector<Rgb> out(exit.size(), Rgb{1, 1, 1});
  if (!(luminance(whole) > 0)) return out;
  for (std::size_t i = 0; i < out.size(); ++i)
    for (int c = 0; c < 3; ++c)
      out[i][c] = std::clamp(exit[i][c] / std::max(whole[c], luminance(whole) / kRange), 1 / kRange,
                             kRange);
  return out;
}

RealSurfaceStage::RealSurfaceStage(const PreparedScene& scene) : scene_(&scene) {}

bool RealSurfaceStage::measure(const lighting::LightEstimate& light, const DirectLightStage& lights,
                               bool lights_changed) {
  const bool first = exit_.empty();
  if (!first && !lights_changed &&
      lighting::largest_visible_change(measured_, light.light) < kVisibleChange)
    return false;
  measured_ = light.light;
  const prt::Mesh& mesh = scene_->real_mesh;
  if (first || lights_changed) lights_ = lights.at_vertices(mesh);
  relight(light);
  return true;
}

// As an object's light: the bake knows what the mesh hides from itself and reflects.
void RealSurfaceStage::relight(const lighting::LightEstimate& light) {
  const prt::Mesh& mesh = scene_->real_mesh;
  const prt::BakedObject& baked = scene_->real->baked;
  const Pose& pose = scene_->real->world_from_bake;
  const bool level = stands_level(baked, pose);
  const RadianceSh& open = residual_for(light, level);
  const RadianceSh residual =
      lighting::ShRotation(glm::transpose(pose.rotation_matrix()), open.bands()) * open;
  RadianceSh sum(prt::kReflectedBands);
  for (const lighting::DistantLight& d : light.lights) {
    const RadianceSh one = reflected_for(d, level);
    for (int n = 0; n < one.size(); ++n) sum[n] += one[n];
  }
  const RadianceSh reflected = reflected_in_bake_frame(sum, level, pose);
  const std::size_t stride = baked.transfer.stride;
  relit_.resize(3 * stride);
  reflected_.resize(3 * stride);
  prt::relight(baked.transfer, residual, relit_);
  prt::relight(baked.reflected, reflected, reflected_);
  arrives_.resize(mesh.positions.size());
  exit_.resize(arrives_.size());
  for (std::size_t i = 0; i < arrives_.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const std::size_t at = static_cast<std::size_t>(c) * stride + i;
      arrives_[i][c] = std::max(0.f, static_cast<float>(kPi) * (relit_[at] + reflected_[at]) +
                                         lights_.open[i][c] - lights_.real_occlusion[i][c]);
      exit_[i][c] = arrives_[i][c] * mesh.albedo[i][c] / static_cast<float>(kPi);
    }
  if (!baked.receiver) return;
  shadows::ReceiverLight on_floor(residual);
  on_floor.lights = reflected;
  for (const lighting::DistantLight& d : light.lights)
    on_floor.distant_irradiance += lighting::irradiance(d, pose.rotation * glm::dvec3(0, 1, 0));
  // Cannot fail: it has a receiver.
  (void)shadows::compose_planar_shadow(baked, on_floor, shadow_);
}

std::vector<Rgb> RealSurfaceStage::ratios(const lighting::LightEstimate& light,
                                          std::span<const Rgb> lost, const LampStage& lamps) const {
  std::vector<Rgb> out(lost.size(), Rgb{1, 1, 1});
  const float smallest = .05f * static_cast<float>(kPi) * luminance(light.mean_radiance);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const Rgb lamp = lamps.any() ? lamps.on_real_mesh()[i] : Rgb{};
    for (int c = 0; c < 3; ++c) {
      if (!(arrives_[i][c] > smallest)) continue;
      const float gone = static_cast<float>(kPi) * lost[i][c] + lights_.virtual_occlusion[i][c];
      out[i][c] = std::clamp(1 - gone / arrives_[i][c], 0.f, 1.5f) + lamp[c] / arrives_[i][c];
    }
  }
  return out;
}

}  // namespace penumbra::runtime
