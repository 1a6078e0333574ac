#include "runtime/shading/real_surface_stage.h"

#include <algorithm>
#include <cmath>

#include "core/conventions.h"
#include "core/parallel.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/relight.h"
#include "prt/transfer/transfer.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/shading/scene_light.h"
#include "runtime/shading/sent_radiance.h"
#include "shadows/field/occlusion_field.h"

namespace penumbra::runtime {

RealSurfaceStage::RealSurfaceStage(const PreparedScene& scene) : scene_(&scene) {
  if (!any()) return;
  for (const PreparedObject& o : scene.objects) areas_.push_back(vertex_areas(o.baked.mesh));
}

bool RealSurfaceStage::measure(const lighting::LightEstimate& light, const DirectLightStage& lights,
                               bool lights_changed) {
  const bool first = exit_.empty();
  if (!first && !lights_changed &&
      lighting::largest_visible_change(measured_, light.light) < CompositeStage::kVisibleChange)
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
  const RadianceSh& open = rest_for(light, level);
  const RadianceSh residual =
      lighting::ShRotation(glm::transpose(pose.rotation_matrix()), open.bands()) * open;
  RadianceSh sum(prt::kIndirectBands);
  for (const lighting::DistantLight& d : light.lights) {
    const RadianceSh one = reflected_for(d, level);
    for (int n = 0; n < one.size(); ++n) sum[n] += one[n];
  }
  const RadianceSh reflected = reflected_in_bake_frame(sum, level, pose);
  const std::size_t stride = baked.transfer.stride;
  relit_.resize(3 * stride);
  reflected_.resize(3 * stride);
  prt::relight(baked.transfer, residual, relit_);
  prt::relight(baked.indirect, reflected, reflected_);
  arrives_.resize(mesh.positions.size());
  exit_.resize(arrives_.size());
  for (std::size_t i = 0; i < arrives_.size(); ++i)
    for (int c = 0; c < 3; ++c) {
      const std::size_t at = static_cast<std::size_t>(c) * stride + i;
      arrives_[i][c] = std::max(0.f, static_cast<float>(kPi) * (relit_[at] + reflected_[at]) +
                                         lights_.open[i][c] - lights_.missing[i][c]);
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

Rgb RealSurfaceStage::radiance_towards(const glm::dvec3& place) const {
  constexpr std::size_t kStep = 16;  // a sixteenth of the vertices is plenty for a mean
  const prt::Mesh& mesh = scene_->real_mesh;
  Rgb sum;
  float weight = 0;
  for (std::size_t i = 0; i < mesh.positions.size(); i += kStep) {
    const glm::vec3 d = glm::vec3(place) - mesh.positions[i];
    const float square = glm::dot(d, d) + 1e-12f,
                angle = glm::dot(mesh.normals[i], d) / (square * std::sqrt(square));
    if (angle <= 0) continue;
    sum += exit_[i] * angle;
    weight += angle;
  }
  return weight > 0 ? sum * (1 / weight) : Rgb{};
}

// What each object takes of the light without lights, where several meet counted once, and what it
// sends from the directions that it blocks.
RealSurfaceStage::ByObjects RealSurfaceStage::by_objects(
    const RadianceSh& light, std::span<const Pose> poses,
    std::span<const std::span<const float>> relit) const {
  const prt::Mesh& mesh = scene_->real_mesh;
  const std::size_t count = mesh.positions.size();
  ByObjects out{std::vector<Rgb>(count, Rgb{1, 1, 1}), std::vector<Rgb>(count)};
  std::vector<std::vector<Rgb>> alone(poses.size(), std::vector<Rgb>(count));
  std::vector<float> form_factors(count);
  for (std::size_t k = 0; k < poses.size(); ++k) {
    const PreparedObject& object = scene_->objects[k];
    const shadows::OcclusionField& field = *object.field;
    const Pose bake_from_world = poses[k].inverse();
    const RadianceSh turned =
        lighting::ShRotation(bake_from_world.rotation_matrix(), light.bands()) * light;
    // Cannot fail: lists of one length, light made for this field.
    (void)shadows::field_ratios(field, shadows::FieldLight(turned, field.bands), bake_from_world,
                                {mesh.positions, mesh.normals, lights_.open}, alone[k],
                                form_factors);
    std::vector<Rgb> shared = alone[k];
    for (std::size_t j = 0; j < k; ++j)
      shadows::smooth_ratios({scene_->objects[j].field.get(), poses[j]}, {&field, poses[k]},
                             mesh.positions, alone[j], shared);
    const SentRadiance sent(object.baked.mesh, areas_[k], relit[k]);
    parallel_for(std::size_t{0}, count, [&](std::size_t i) {
      out.left[i] = out.left[i] * shared[i];
      if (form_factors[i] <= 0) return;
      const glm::vec3 at(bake_from_world * glm::dvec3(mesh.positions[i]));
      // From directions that an object before it blocks too, that one sends.
      const float taken = 1 - luminance(alone[k][i]), own = 1 - luminance(shared[i]);
      const float fraction = taken > 0 ? std::clamp(own / taken, 0.f, 1.f) : 1;
      out.sent[i] += sent.towards(at - field.centre) * (form_factors[i] * fraction);
    });
  }
  return out;
}

std::vector<Rgb> RealSurfaceStage::ratios(const lighting::LightEstimate& light,
                                          std::span<const Pose> poses,
                                          std::span<const std::span<const float>> relit,
                                          const LampStage& lamps) const {
  const prt::Mesh& mesh = scene_->real_mesh;
  const RadianceSh around = rest_around(light, scene_->planes);
  const ByObjects objects = by_objects(around, poses, relit);
  std::vector<Rgb> out = objects.left;
  const IrradianceSh residual = lighting::irradiance(around);
  const float smallest = .05f * static_cast<float>(kPi) * luminance(light.mean_radiance);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const Rgb lamp = lamps.any() ? lamps.on_real_mesh()[i] : Rgb{};
    if (out[i] == Rgb{1, 1, 1} && luminance(lights_.taken[i]) == 0 && luminance(lamp) == 0 &&
        luminance(objects.sent[i]) == 0)
      continue;
    const Rgb open = lighting::evaluate(residual, glm::dvec3(mesh.normals[i]));
    for (int c = 0; c < 3; ++c) {
      // Of the residual an object takes the same fraction whether real things left all of it or
      // not.
      const float direct = arrives_[i][c] - (lights_.open[i][c] - lights_.missing[i][c]),
                  fraction = open[c] > 0 ? std::clamp(direct / open[c], 0.f, 1.f) : 0;
      const float lost = (1 - out[i][c]) * (open[c] + lights_.open[i][c]) * fraction +
                         lights_.taken[i][c] - objects.sent[i][c];
      out[i][c] = arrives_[i][c] > smallest
                      ? std::clamp(1 - lost / arrives_[i][c], 0.f, 1.5f) + lamp[c] / arrives_[i][c]
                      : 1;
    }
  }
  return out;
}

}  // namespace penumbra::runtime
