// The part of CompositeStage that brings the world's light to one object, past whatever stands
// around it.
#include <algorithm>
#include <cmath>

#include "core/background_task.h"
#include "core/conventions.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/transfer.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/shading/occlusion_probes.h"
#include "runtime/shading/scene_light.h"
#include "shadows/visibility/lamp.h"

namespace penumbra::runtime {

namespace {

void add(RadianceSh& sum, const RadianceSh& other, float factor) {
  for (int n = 0; n < sum.size(); ++n) sum[n] += factor * other[n];
}

// What stands beside an object takes broad parts of its light: so many bands of the difference are
// seen.
constexpr int kSideBands = 3, kFloorBands = 5;

// out[v] += w(v) (in[v] + glow) for all three colours.
void add_to_side(std::span<const OcclusionProbes::Belongs> side, std::span<const float> in,
                 const Rgb& glow, std::span<float> out) {
  const std::size_t stride = out.size() / 3;
  for (std::size_t c = 0; c < 3; ++c) {
    const float shine = glow[static_cast<int>(c)];
    for (const OcclusionProbes::Belongs& b : side)
      out[c * stride + b.vertex] += b.weight * (in[c * stride + b.vertex] + shine);
  }
}

}  // namespace

bool CompositeStage::differs_visibly(const ObjectLight& before, const ObjectLight& now) {
  const auto differs = [](const RadianceSh& a, const RadianceSh& b) {
    return !(a == b) && lighting::largest_visible_change(a, b) >= kVisibleChange;
  };
  bool any = differs(before.open, now.open) || differs(before.receiver, now.receiver);
  const float visible =
      static_cast<float>(kVisibleChange * luminance(now.open[0]) / std::sqrt(4 * kPi));
  for (std::size_t k = 0; k < kProbeDirections; ++k) {
    any |= differs(before.side[k], now.side[k]);
    any |= std::abs(luminance(before.instead[k]) - luminance(now.instead[k])) > visible ||
           std::abs(before.floor_hidden[k] - now.floor_hidden[k]) > kVisibleChange;
  }
  return any;
}

CompositeStage::ObjectLight CompositeStage::light_at(std::size_t index,
                                                     const lighting::LightEstimate& estimate,
                                                     const std::vector<Pose>& poses) const {
  const RadianceSh& light =
      rest_for(estimate, stands_level(objects_[index].prepared->baked, poses[index]));
  const lighting::ShRotation turn(glm::transpose(poses[index].rotation_matrix()), light.bands());
  ObjectLight out;
  out.open = out.receiver = turn * light;
  out.side.fill(out.open);
  if (surroundings_.any()) see_surroundings(index, light, poses, turn, out);
  return out;
}

void CompositeStage::see_surroundings(std::size_t index, const RadianceSh& light,
                                      const std::vector<Pose>& poses,
                                      const lighting::ShRotation& turn, ObjectLight& out) const {
  const prt::Mesh& mesh = objects_[index].prepared->baked.mesh;
  const glm::dvec3 centre = poses[index] * glm::dvec3(prt::bounds_of(mesh).centre());
  const Rgb by_real = radiance_towards(scene_.real_mesh, {}, centre,
                                       [&](std::size_t i) { return real_.exit()[i]; }),
            by_virtual = radiance_of_neighbours(index, centre, poses);
  out.receiver = turn * with_occluder_radiance(light, surroundings_.by_real(index), by_real);
  for (int k = 0; k < kProbeDirections; ++k) {
    const ProbeView& view = surroundings_.view(index, k);
    const auto s = static_cast<std::size_t>(k);
    if (const float hidden = view.floor_behind_real + view.floor_behind_virtual; hidden > 0) {
      out.floor_hidden[s] = hidden / (hidden + view.floor);
      out.instead[s] = by_real * view.floor_behind_real + by_virtual * view.floor_behind_virtual;
    }
    if (view.by_real.fraction == 0 && view.by_virtual.fraction == 0) continue;
    out.side[s] =
        turn * with_occluder_radiance(with_occluder_radiance(light, view.by_real, by_real),
                                      view.by_virtual, by_virtual);
  }
}

// Mean of what the other objects send this way, by how near they are.
Rgb CompositeStage::radiance_of_neighbours(std::size_t index, const glm::dvec3& centre,
                                           const std::vector<Pose>& poses) const {
  Rgb sum;
  float weight = 0;
  for (std::size_t k = 0; k < objects_.size(); ++k) {
    if (k == index) continue;
    const prt::BakedObject& baked = objects_[k].prepared->baked;
    const std::vector<float>& relit = objects_[k].relit;
    const std::size_t stride = baked.transfer.stride;
    const glm::dvec3 apart = poses[k].translation - centre;
    const auto w = static_cast<float>(1 / (glm::dot(apart, apart) + 1e-6));
    sum += w * radiance_towards(baked.mesh, poses[k], centre, [&](std::size_t i) {
             return Rgb{relit[i], relit[stride + i], relit[2 * stride + i]} * baked.mesh.albedo[i];
           });
    weight += w;
  }
  return weight > 0 ? sum * (1 / weight) : Rgb{};
}

namespace {

// The lamp's light at a place.
lighting::DistantLight as_distant_light(const shadows::Lamp& lamp, const glm::dvec3& at) {
  const glm::dvec3 to = lamp.position - at;
  const double distance = std::max(glm::length(to), 2 * lamp.radius_m);
  lighting::DistantLight out;
  out.direction = glm::length(to) > 0 ? glm::normalize(to) : glm::dvec3(0, 1, 0);
  const double sine = lamp.radius_m / distance;
  out.radius = Radians(std::asin(sine));
  out.radiance =
      lamp.irradiance_at_1m * static_cast<float>(1 / (distance * distance * kPi * sine * sine));
  return out;
}

}  // namespace

void CompositeStage::add_distant_lights(std::size_t index, const lighting::LightEstimate& estimate,
                                        const Pose& pose, ObjectLight& out) const {
  const bool level = stands_level(objects_[index].prepared->baked, pose);
  const glm::dvec3 up = pose.rotation * glm::dvec3(0, 1, 0);
  RadianceSh sum(prt::kIndirectBands);
  std::array<RadianceSh, kProbeDirections> side;
  side.fill(sum);
  for (std::size_t i = 0; i < estimate.lights.size(); ++i) {
    const lighting::DistantLight& d = estimate.lights[i];
    const RadianceSh own = reflected_for(d, level);
    add(sum, own, 1);
    for (int k = 0; k < kProbeDirections; ++k)
      add(side[static_cast<std::size_t>(k)], own, lights_.reflected_fraction(i, index, k));
    out.distant_irradiance += lighting::irradiance(d, up);
  }
  // What object and floor reflect of a lamp: as if it were as far for all of them as for the
  // object's middle.
  glm::dvec3 centre(0);
  if (!scene_.lamps.empty())
    centre = pose * glm::dvec3(prt::bounds_of(objects_[index].prepared->baked.mesh).centre());
  for (const shadows::Lamp& lamp : scene_.lamps) {
    const RadianceSh own = reflected_for(as_distant_light(lamp, centre), level);
    add(sum, own, 1);
    for (RadianceSh& s : side) add(s, own, 1);
  }
  const auto in_bake_frame = [&](const RadianceSh& light) {
    return reflected_in_bake_frame(light, level, pose,
                                   objects_[index].prepared->baked.indirect.bands);
  };
  out.lights = in_bake_frame(sum);
  bool all_open = true;
  for (std::size_t k = 0; k < kProbeDirections; ++k) {
    all_open &= side[k] == sum;
    out.side_lights[k] = side[k] == sum ? out.lights : in_bake_frame(side[k]);
  }
  out.receiver_lights = out.lights;
  if (all_open) return;
  out.receiver_lights = RadianceSh(prt::kIndirectBands);
  for (const RadianceSh& s : out.side_lights) add(out.receiver_lights, s, 1.f / kProbeDirections);
}

// The open light everywhere, and on each side what differs there.
void CompositeStage::relight(StageObject& o, const ObjectLight& light, std::size_t index) const {
  using TransferPart = PreparedObject::TransferPart;
  const bool lights = light.lights.bands() > 1;
  const auto difference = [](RadianceSh a, const RadianceSh& b) {
    add(a, b, -1);
    return a;
  };
  relight_parts(o, TransferPart::kSurface, light.open, lights ? &light.lights : nullptr, o.relit);
  o.more.resize(o.relit.size());
  const RadianceSh no_lights(prt::kIndirectBands);
  for (int k = 0; k < kProbeDirections; ++k) {
    const auto s = static_cast<std::size_t>(k);
    const auto vertices = surroundings_.vertices(index, k);
    if (!(light.side[s] == light.open)) {
      o.prepared->relight(TransferPart::kSurface,
                          difference(light.side[s], light.open).with_bands(kSideBands), o.more);
      add_to_side(vertices, o.more, {}, o.relit);
    }
    // Of what object and floor reflect to each other, the floor that is hidden or in shade is
    // missing.
    const bool shaded = lights && !(light.side_lights[s] == light.lights);
    if (!shaded && light.floor_hidden[s] == 0) continue;
    RadianceSh missing = shaded ? difference(light.side_lights[s], light.lights) : no_lights;
    add(missing, light.open.with_bands(prt::kIndirectBands), -light.floor_hidden[s]);
    o.prepared->relight(TransferPart::kReflected, missing.with_bands(kFloorBands), o.more);
    add_to_side(vertices, o.more, light.instead[s], o.relit);
  }
  if (lights) lights_.add_light(index, o.relit);
  if (lamps_.any()) lamps_.add_light(index, o.relit);
}

}  // namespace penumbra::runtime
