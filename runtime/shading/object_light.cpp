// The part of CompositeStage that brings the world's light to one object, past whatever stands
// around it.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/conventions.h"
#include "core/threads/parallel.h"
#include "core/threads/scratch.h"
#include "lighting/estimate.h"
#include "lighting/light_estimate.h"
#include "lighting/lights/distant_light.h"
#include "lighting/sh/basis.h"
#include "lighting/sh/irradiance.h"
#include "lighting/sh/rotation.h"
#include "prt/bake/bake.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/transfer.h"
#include "runtime/direct/scene_light.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/surroundings/occlusion_probes.h"
#include "shadows/visibility/lamp.h"

namespace penumbra::runtime {

namespace {

void add(RadianceSh& sum, const RadianceSh& other, float factor) {
  for (int n = 0; n < sum.size(); ++n) sum[n] += factor * other[n];
}

RadianceSh difference(const RadianceSh& a, const RadianceSh& b) {
  RadianceSh out = a;
  add(out, b, -1);
  return out;
}

}  // namespace

bool CompositeStage::differs_visibly(const RadianceSh& before, const RadianceSh& now) {
  return !(before == now) && lighting::largest_visible_change(before, now) >= kVisibleChange;
}

bool CompositeStage::differs_visibly(const ObjectLight& before, const ObjectLight& now) {
  bool any = differs_visibly(before.open, now.open) || differs_visibly(before.local, now.local);
  const float visible =
      static_cast<float>(kVisibleChange * luminance(now.open[0]) / std::sqrt(4 * kPi));
  for (std::size_t k = 0; k < now.around.size(); ++k)
    any |= std::abs(luminance(before.around[k]) - luminance(now.around[k])) > visible ||
           std::abs(before.left(k) - now.left(k)) > kVisibleChange;
  return any;
}

CompositeStage::ObjectLight CompositeStage::light_at(std::size_t index,
                                                     const lighting::LightEstimate& estimate,
                                                     const std::vector<Pose>& poses) const {
  const RadianceSh& light =
      residual_for(estimate, stands_level(objects_[index].prepared->baked, floor_of(index)));
  const lighting::ShRotation turn(glm::transpose(floor_of(index).rotation_matrix()), light.bands());
  ObjectLight out;
  out.open = out.local = turn * light;
  if (surroundings_.any()) {
    const StageTimer timer(times_, "surroundings");
    see_surroundings(index, estimate, poses, turn, out);
  }
  return out;
}

PlaneLight::Radiance CompositeStage::exit_of_real(const RealPoint& at) const {
  if (at.plane != RealPoint::kMesh)
    return plane_light_->at(static_cast<std::size_t>(at.plane), at.on_plane);
  if (at.back) return {};
  const Rgb before = real_.exit()[at.vertex];
  return {before, real_ratios_.empty() ? before : before * real_ratios_[at.vertex]};
}

Rgb CompositeStage::exit_of(const ProbeHit& hit) const {
  if (hit.thing == ProbeHit::kReal) return exit_of_real(hit.real).now;
  return exit_of_object(static_cast<std::size_t>(hit.thing), hit.vertex);
}

Rgb CompositeStage::exit_of_object(std::size_t object, std::uint32_t vertex) const {
  const StageObject& o = objects_[object];
  const std::size_t stride = o.relit.size() / 3;
  return Rgb{o.relit[vertex], o.relit[stride + vertex], o.relit[2 * stride + vertex]} *
         o.prepared->baked.mesh.albedo[vertex];
}

// The light around an object with the real mesh in it, as the object's surface sees it as a whole.
RadianceSh CompositeStage::with_real_things(const RadianceSh& light, std::size_t index) const {
  RadianceSh out = light;
  constexpr auto kSolidAngle = static_cast<float>(4 * kPi / OcclusionProbes::kSphereRays);
  double basis[kMaxCoefficients];
  for (const RealHit& hit : surroundings_.by_real(index)) {
    const glm::dvec3 d(hit.direction);
    const Rgb change = exit_of_real(hit.at).now - lighting::evaluate(light, d);
    lighting::evaluate_basis(light.bands(), d, basis);
    for (int n = 0; n < out.size(); ++n)
      out[n] += change * (kSolidAngle * static_cast<float>(basis[n]));
  }
  return out;
}

// Shadows whose plane a floor point may lie on. What two objects block in common the shown ones
// count once.
void CompositeStage::find_floor_shadows(std::size_t index,
                                        std::pmr::vector<FloorShadow>& out) const {
  const auto add = [&](const shadows::PlanarShadow* shadow, const prt::BakedObject& baked,
                       const Pose& bake_from_world, float of_open, bool real,
                       const shadows::PlanarShadow* counted) {
    out.push_back({shadow, &baked.receiver->grid, bake_from_world.rotation_matrix(),
                   bake_from_world.translation, of_open, real, counted});
  };
  if (real_.any() && real_.shadow() && scene_.real->baked.receiver)
    add(real_.shadow(), scene_.real->baked, scene_.real->world_from_bake.inverse(), 1, true,
        nullptr);
  for (std::size_t k = 0; k < objects_.size(); ++k) {
    const StageObject& o = objects_[k];
    if (o.prepared->baked.receiver && !o.shadow.ratio.empty())
      add(&o.shown(), o.prepared->baked, floor_of(k).inverse(), luminance(o.of_open), false,
          k == index ? &o.shadow : nullptr);
  }
}

// A shadow's ratio counts the lights, so that what it takes of the residual is more of that.
// in: over the residual of the plane as if it were alone: local, the local residual, open, the
//     residual of the plane beside others, and all, that and the distant lights
CompositeStage::FloorLight CompositeStage::floor_at(const glm::vec3& point,
                                                    std::span<const FloorShadow> floor_shadows,
                                                    float local, float open, float all) {
  FloorLight out{local, open};
  float virtual_occlusion = 0;  // by objects
  for (const FloorShadow& s : floor_shadows) {
    const glm::dvec3 p = s.turn * glm::dvec3(point) + s.shift;
    if (std::abs(p.y - double(s.grid->height)) > kOnPlane_m) continue;
    const auto texel = shadows::texel_at(*s.grid, {p.x, p.z});
    if (!texel) continue;
    const auto taken_by = [&](const shadows::PlanarShadow& shadow) {
      if (shadow.empty()) return 0.f;
      return s.of_open * (1 - luminance(shadow.ratio.at(texel->x, texel->y))) * all;
    };
    if (s.real)
      out.left -= taken_by(*s.shadow);
    else
      virtual_occlusion += taken_by(*s.shadow);
    if (s.counted) out.counted -= taken_by(*s.counted);
  }
  return {std::max(out.counted, 0.f), std::max(std::max(out.left, 0.f) - virtual_occlusion, 0.f)};
}

void CompositeStage::see_surroundings(std::size_t index, const lighting::LightEstimate& estimate,
                                      const std::vector<Pose>& poses,
                                      const lighting::ShRotation& turn, ObjectLight& out) const {
  const Pose &pose = poses[index], &on_floor = floor_of(index);
  const prt::BakedObject& baked = objects_[index].prepared->baked;
  const RadianceSh& light = residual_for(estimate, stands_level(baked, on_floor));
  // What is left for the probes to mend is little, so that little is lost between them.
  const RadianceSh local = with_real_things(light, index);
  out.local = turn * local;
  const float weight = 1 / static_cast<float>(surroundings_.rays(index));
  const IrradianceSh irradiance = lighting::irradiance(light),
                     local_irradiance = lighting::irradiance(local);
  const glm::dvec3 up = on_floor.rotation * glm::dvec3(0, 1, 0);
  const auto sent_on = [&](const Rgb& albedo, const glm::dvec3& normal, const IrradianceSh& by) {
    return std::max(0.f, luminance(albedo * lighting::evaluate(by, normal)));
  };
  const Rgb floor_albedo = baked.receiver ? baked.receiver->albedo : Rgb{};
  const float of_floor = sent_on(floor_albedo, up, irradiance);
  const Scratch::Scope scope;
  std::pmr::vector<FloorShadow> shadows_there(scope.memory());
  find_floor_shadows(index, shadows_there);
  const float residual = luminance(lighting::evaluate(irradiance, up));
  const float open_residual = residual + luminance(planes_.change_under(baked, on_floor));
  float all = open_residual;
  for (const lighting::DistantLight& d : estimate.lights)
    all += luminance(lighting::irradiance(d, up));
  const float local_residual = luminance(lighting::evaluate(local_irradiance, up)),
              of_residual = residual > 0 ? local_residual / residual : 1,
              open = residual > 0 ? open_residual / residual : 1;
  all = residual > 0 ? all / residual : 1;
  const RadianceSh gone = difference(light, local);
  const auto see = [&](const ProbeHit& hit) {
    if (hit.thing == ProbeHit::kProbe) return;
    if (hit.thing == ProbeHit::kItself) {
      const float own =
          sent_on(baked.mesh.albedo[hit.vertex],
                  pose.rotation * glm::dvec3(baked.mesh.normals[hit.vertex]), local_irradiance);
      out.reflected[hit.probe] += own;
      out.reflected_left[hit.probe] += own;
      return;
    }
    const bool thing = hit.thing != ProbeHit::kFloor;  // a real or a virtual one
    if (thing) out.around[hit.probe] += exit_of(hit) * weight;
    if (hit.above_floor) {
      const FloorLight floor = floor_at(hit.point, shadows_there, of_residual, open, all);
      out.reflected[hit.probe] += of_floor * floor.counted;
      if (!thing) out.reflected_left[hit.probe] += of_floor * floor.left;
    } else {
      out.around[hit.probe] += lighting::evaluate(local, glm::dvec3(hit.direction)) * -weight;
    }
  };
  const auto hits = surroundings_.hits(index);
  const auto open_rays = surroundings_.open_rays(index);
  const auto parts = surroundings_.parts(index);
  parallel_for(std::size_t{0}, parts.size(), [&](std::size_t i) {
    const OcclusionProbes::ProbePart& part = parts[i];
    for (std::size_t k = part.first_hit; k < part.last_hit; ++k) see(hits[k]);
    for (std::size_t k = part.first_open; k < part.last_open; ++k)
      out.around[open_rays[k].probe] +=
          lighting::evaluate(gone, glm::dvec3(open_rays[k].direction)) * weight;
  });
}

glm::dvec3 CompositeStage::lit_centre(std::size_t index, const Pose& pose) const {
  return pose * glm::dvec3(prt::bounds_of(objects_[index].prepared->baked.mesh).centre());
}

// The lamp's light at the middle of the object: what object and floor reflect of it is as if it
// were as far for all of them.
lighting::DistantLight CompositeStage::lamp_as_distant(const shadows::Lamp& lamp,
                                                       const glm::dvec3& centre) {
  const glm::dvec3 to = lamp.position - centre;
  const double distance = std::max(glm::length(to), 2 * lamp.radius_m);
  lighting::DistantLight out;
  out.direction = glm::length(to) > 0 ? glm::normalize(to) : glm::dvec3(0, 1, 0);
  const double sine = lamp.radius_m / distance;
  out.radius = Radians(std::asin(sine));
  out.radiance =
      lamp.irradiance_at_1m * static_cast<float>(1 / (distance * distance * kPi * sine * sine));
  return out;
}

// How much of a distant light reaches the object as a whole past everything else.
float CompositeStage::lit_fraction(std::size_t source, std::size_t index, const Pose& pose) const {
  const prt::Mesh& mesh = objects_[index].prepared->baked.mesh;
  const glm::dvec3 towards = glm::conjugate(pose.rotation) * lights_.direction(source);
  const std::span<const ProbeHit> hits = surroundings_.hits(index);
  const std::span<const std::uint8_t> shade = lights_.hit_shade(source, index);
  double all = 0, lit = 0;
  for (std::size_t k = 0; k < hits.size(); ++k) {
    if (hits[k].thing != ProbeHit::kProbe || (shade[k] & DirectLightStage::kByItself)) continue;
    const double cosine = std::max(0., glm::dot(glm::dvec3(mesh.normals[hits[k].vertex]), towards));
    all += cosine;
    if (!(shade[k] & DirectLightStage::kByOthers)) lit += cosine;
  }
  return all > 0 ? static_cast<float>(lit / all) : 1;
}

void CompositeStage::add_distant_lights(std::size_t index, const lighting::LightEstimate& estimate,
                                        const Pose& pose, ObjectLight& out) const {
  const Pose& floor = floor_of(index);
  const bool level = stands_level(objects_[index].prepared->baked, floor);
  const glm::dvec3 up = floor.rotation * glm::dvec3(0, 1, 0);
  RadianceSh sum(prt::kReflectedBands);
  RadianceSh lit = sum;  // as far as it reaches the object
  for (std::size_t i = 0; i < estimate.lights.size(); ++i) {
    const lighting::DistantLight& d = estimate.lights[i];
    const RadianceSh own = reflected_for(d, level);
    add(sum, own, 1);
    add(lit, own, surroundings_.any() ? lit_fraction(i, index, pose) : 1);
    out.distant_irradiance += lighting::irradiance(d, up);
  }
  if (!scene_.lamps.empty()) {
    const glm::dvec3 centre = lit_centre(index, pose);
    for (const shadows::Lamp& lamp : scene_.lamps) {
      const RadianceSh own = reflected_for(lamp_as_distant(lamp, centre), level);
      add(sum, own, 1);
      add(lit, own, 1);
    }
  }
  const auto in_bake_frame = [&](const RadianceSh& light) {
    return reflected_in_bake_frame(light, level, floor,
                                   objects_[index].prepared->baked.reflected.bands);
  };
  out.lights = in_bake_frame(sum);
  out.reaching_lights = lit == sum ? out.lights : in_bake_frame(lit);
}

// What floor and object send of a distant light to each probe.
struct CompositeStage::SentLight {
  // As the bake has it, and past what stands around: for a light of unit irradiance, luminance.
  OcclusionProbes::Values all{}, left{};
  // The latter with what the object sends on to itself, in the light's own power: irradiance/pi.
  std::array<Rgb, OcclusionProbes::kProbes> gathered{};
};

CompositeStage::SentLight CompositeStage::sent_at_probes(std::size_t light_index, std::size_t index,
                                                         const lighting::DistantLight& source,
                                                         const Pose& pose) const {
  const prt::BakedObject& baked = objects_[index].prepared->baked;
  const std::span<const ProbeHit> hits = surroundings_.hits(index);
  const std::span<const std::uint8_t> shade = lights_.hit_shade(light_index, index);
  const float weight = 1 / static_cast<float>(surroundings_.rays(index));
  const glm::vec3 towards(glm::conjugate(pose.rotation) * source.direction);
  const Rgb power_per_ray = source.irradiance() * (weight / float(kPi));
  const auto on_floor = static_cast<float>(
      glm::dot(floor_of(index).rotation * glm::dvec3(0, 1, 0), source.direction));
  const Rgb of_floor = baked.receiver ? baked.receiver->albedo * std::max(0.f, on_floor) : Rgb{};
  SentLight out;
  const auto see = [&](std::size_t k) {
    const ProbeHit& hit = hits[k];
    const bool itself = hit.thing == ProbeHit::kItself;
    if ((!hit.above_floor && !itself) || (shade[k] & DirectLightStage::kByItself)) return;
    const Rgb sent = itself ? baked.mesh.albedo[hit.vertex] *
                                  std::max(0.f, glm::dot(baked.mesh.normals[hit.vertex], towards))
                            : of_floor;
    out.all[hit.probe] += luminance(sent);
    const bool in_sight = itself || hit.thing == ProbeHit::kFloor;
    if (!in_sight || (shade[k] & DirectLightStage::kByOthers)) return;
    out.left[hit.probe] += luminance(sent);
    out.gathered[hit.probe] += sent * power_per_ray;
  };
  const auto parts = surroundings_.parts(index);
  const auto for_hits = [&](const auto& body) {  // of other probes at the same time
    parallel_for(std::size_t{0}, parts.size(), [&](std::size_t i) {
      for (std::size_t k = parts[i].first_hit; k < parts[i].last_hit; ++k) body(k);
    });
  };
  for_hits(see);
  if (out.left == out.all) return out;
  const auto first = out.gathered;
  for (int bounce = 0; bounce < kOwnBounces; ++bounce) {
    auto next = first;
    for_hits([&](std::size_t k) {
      if (hits[k].thing == ProbeHit::kItself)
        next[hits[k].probe] += baked.mesh.albedo[hits[k].vertex] *
                               surroundings_.at_vertex(index, out.gathered, hits[k].vertex) *
                               weight;
    });
    out.gathered = next;
  }
  return out;
}

// What object and floor reflect to each other where others hide the floor, or shade one of them.
// What little of a distant light is left comes from a small part of the floor: other parts of the
// object see that than see the bake's whole floor.
void CompositeStage::correct_reflected(StageObject& o, const ObjectLight& light, std::size_t index,
                                       const lighting::LightEstimate& estimate, const Pose& pose) {
  const prt::BakedObject& baked = o.prepared->baked;
  const Pose& floor = floor_of(index);
  const bool level = stands_level(baked, floor);
  o.more.resize(o.relit.size());
  if (light.reflected_left != light.reflected) {
    relight_reflected(o, PreparedObject::TransferPart::kSurface,
                      light.local.with_bands(prt::kReflectedBands), o.more);
    surroundings_.take_missing(index, light.reflected_left, light.reflected, o.more, o.relit);
  }
  double all = 0, left = 0;  // of all lights
  for (std::size_t j = 0; j < estimate.lights.size(); ++j) {
    const lighting::DistantLight& source = estimate.lights[j];
    const SentLight sent = sent_at_probes(j, index, source, pose);
    const double power = luminance(source.irradiance());
    all += power * std::accumulate(sent.all.begin(), sent.all.end(), 0.);
    left += power * std::accumulate(sent.left.begin(), sent.left.end(), 0.);
    if (sent.left == sent.all) continue;
    relight_reflected(
        o, PreparedObject::TransferPart::kSurface,
        reflected_in_bake_frame(reflected_for(source, level), level, floor, baked.reflected.bands),
        o.more);
    surroundings_.replace_shaded(index, sent.left, sent.all, sent.gathered, o.more, o.relit);
  }
  const float residual =
      luminance(lighting::evaluate(lighting::irradiance(light.local), glm::dvec3(0, 1, 0)));
  const bool matters = luminance(light.distant_irradiance) > residual,
             stands = !o.prepared->animation || o.holds;
  surroundings_.want_fine(index, matters && stands && left < kDeepShade * all);
}

// The light that the bake counts on, and what differs around the object.
void CompositeStage::relight(StageObject& o, const ObjectLight& light, std::size_t index,
                             const lighting::LightEstimate& estimate, const Pose& pose) {
  const bool lights = light.lights.bands() > 1;
  relight_parts(o, PreparedObject::TransferPart::kSurface, light.local,
                lights ? &light.lights : nullptr, o.relit);
  if (surroundings_.any()) {
    correct_reflected(o, light, index, estimate, pose);
    surroundings_.spread(index, light.around, o.relit);
    for (float& v : o.relit) v = std::max(v, 0.f);
  }
  if (lights) lights_.add_light(index, o.relit);
  if (lamps_.any()) lamps_.add_light(index, o.relit);
}

}  // namespace penumbra::runtime
