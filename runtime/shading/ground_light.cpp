// The part of CompositeStage that tells what an object changes on the floor beside real things.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory_resource>
#include <span>
#include <vector>

#include "core/threads/scratch.h"
#include "lighting/sh/basis.h"
#include "prt/bake/bake.h"
#include "prt/transfer/transfer.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/surroundings/ground_probes.h"
#include "runtime/surroundings/plane_light.h"

namespace penumbra::runtime {

// The bake takes the local light in all directions in which the object stands. From a point of the
// floor another part of a real thing may be behind the object, or before it; and of what is seen
// past it the object has taken some.
void CompositeStage::take_what_is_behind(std::size_t index, const RadianceSh& sky, const Pose& pose,
                                         const RadianceSh& local, std::span<float> deficit) const {
  std::array<Rgb, GroundProbes::kPoints> more{};
  std::array<bool, GroundProbes::kPoints> own{};
  for (std::size_t p = 0; p < own.size(); ++p)
    own[p] = is_nearest(index, ground_probes_.place(index, p));
  const glm::dquat bake_from_world = glm::conjugate(pose.rotation);
  for (const GroundHit& hit : ground_probes_.hits(index)) {
    const glm::dvec3 d(hit.direction);
    const PlaneLight::Radiance there =
        hit.real ? exit_of_real(hit.at) : PlaneLight::Radiance{lighting::evaluate(sky, d), {}};
    Rgb change;
    if (hit.object_first)
      change = there.before;
    else if (own[hit.point])
      change = there.before - there.now;
    if (hit.bake_blocks) change = change - lighting::evaluate(local, bake_from_world * d);
    more[hit.point] += change * (1.f / GroundProbes::kRays);
  }
  ground_probes_.spread(index, more, objects_[index].prepared->baked.receiver->grid.size, deficit);
}

namespace {

// A light that the object does not get at all lets it send what it shows; half of it, too: from
// there on less and less of that is mixed with what the bake expects, which has no noise.
float fraction_as_shown(const RadianceSh& lights, const RadianceSh& lit) {
  const float all = luminance(lights[0]), left = luminance(lit[0]);
  return all > 0 ? std::clamp(2 * (1 - left / all), 0.f, 1.f) : 0;
}

// The middle of a point's cell of the ground grid, a plane for each colour.
Rgb in_middle_of(std::size_t point, int size, std::span<const float> texels) {
  const auto first = [size](std::size_t cell) {
    return std::clamp((2 * static_cast<int>(cell) + 1) * size / (2 * GroundProbes::kSize) - 1, 0,
                      std::max(size - 2, 0));
  };
  const int x0 = first(point % GroundProbes::kSize), y0 = first(point / GroundProbes::kSize);
  const std::size_t stride = texels.size() / 3;
  Rgb sum;
  for (int y = y0; y < std::min(y0 + 2, size); ++y)
    for (int x = x0; x < std::min(x0 + 2, size); ++x)
      for (std::size_t c = 0; c < 3; ++c)
        sum[static_cast<int>(c)] += texels[c * stride + static_cast<std::size_t>(y * size + x)];
  return sum * .25f;
}

}  // namespace

// Whether a distant light reaches the object's probes past itself (r), and past all else too (g).
std::array<Rgb, OcclusionProbes::kProbes> CompositeStage::lit_probes(std::size_t source,
                                                                     std::size_t index) const {
  std::array<Rgb, OcclusionProbes::kProbes> out{};
  const std::span<const ProbeHit> hits = surroundings_.hits(index);
  const std::span<const std::uint8_t> shade = lights_.hit_shade(source, index);
  for (std::size_t k = 0; k < hits.size(); ++k)
    if (hits[k].thing == ProbeHit::kProbe && !(shade[k] & DirectLightStage::kByItself))
      out[hits[k].probe] = {1, shade[k] & DirectLightStage::kByOthers ? 0.f : 1.f, 0};
  return out;
}

// Of the lights that the object reflects onto the floor in the open, what is left past others, by
// texel of its ground grid and channel: what a place sees of the object may lie in a neighbour's
// shadow. Nothing where all of them reach all of it.
void CompositeStage::find_lit(std::size_t index, const lighting::LightEstimate& estimate,
                              const Pose& pose, const ObjectLight& light,
                              std::pmr::vector<float>& out) {
  if (light.reaching_lights == light.lights) return;
  const prt::BakedObject& baked = objects_[index].prepared->baked;
  ground_probes_.look_once(index, lights_.occluders());
  // What the rays of a point meet, as lit if nothing stood around, and as it is. Few rays tell
  // little, so the object as a whole counts as one of them.
  std::array<Rgb, GroundProbes::kPoints> alone, left;
  alone.fill(light.lights[0]);
  left.fill(light.reaching_lights[0]);
  const auto look = [&](const lighting::DistantLight& source, const auto& lit_at) {
    const glm::vec3 towards(glm::conjugate(pose.rotation) * source.direction);
    const Rgb power = source.irradiance();
    for (const GroundHit& hit : ground_probes_.hits(index)) {
      if (!hit.bake_blocks || hit.inside) continue;
      const float cosine = glm::dot(baked.mesh.normals[hit.vertex], towards);
      if (cosine <= 0) continue;
      const Rgb lit = lit_at(hit.vertex), sent = power * baked.mesh.albedo[hit.vertex] * cosine;
      alone[hit.point] += sent * lit.r;
      left[hit.point] += sent * lit.g;
    }
  };
  for (std::size_t j = 0; j < estimate.lights.size(); ++j) {
    const auto probes = lit_probes(j, index);
    look(estimate.lights[j],
         [&](std::uint32_t vertex) { return surroundings_.at_vertex(index, probes, vertex); });
  }
  if (!scene_.lamps.empty()) {
    const glm::dvec3 centre = lit_centre(index, pose);
    for (const shadows::Lamp& lamp : scene_.lamps)
      look(lamp_as_distant(lamp, centre), [](std::uint32_t) { return Rgb{1, 1, 0}; });
  }
  std::array<Rgb, GroundProbes::kPoints> fraction;
  for (std::size_t p = 0; p < fraction.size(); ++p)
    for (int c = 0; c < 3; ++c)
      fraction[p][c] = alone[p][c] > 0 ? std::clamp(left[p][c] / alone[p][c], 0.f, 1.f) : 1;
  out.assign(objects_[index].deficit.size(), 0.f);
  ground_probes_.spread(index, fraction, baked.receiver->grid.size, out);
}

// What object and floor reflect onto the floor of these lights, in the measure of find_lit().
void CompositeStage::add_ground_reflected(const StageObject& o, const RadianceSh& lights,
                                          std::span<const float> lit, std::span<float> out) const {
  const Scratch::Scope scope;
  std::pmr::vector<float> sent(out.size(), 0.f, scope.memory());
  relight_reflected(o, PreparedObject::TransferPart::kGround, lights, sent);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] += lit[i] * sent[i];
}

// What the object reflects onto the floor does not go through real things. Where something takes
// the lights from the object, it sends what it shows, since what lies in light beside it may light
// it from elsewhere than the bake has the floor do.
void CompositeStage::correct_reflections(std::size_t index, const ObjectLight& light,
                                         std::span<const float> lit) {
  StageObject& o = objects_[index];
  const prt::BakedObject& baked = o.prepared->baked;
  const bool lights = light.lights.bands() > 1;
  const float as_shown = lights ? fraction_as_shown(light.lights, light.reaching_lights) : 0;
  constexpr float kPerRay = 1.f / GroundProbes::kRays;
  // Of a point's rays that meet the object, how many a real thing stops first, all, and how many
  // meet its back; and the light along those that nothing stops.
  std::array<Rgb, GroundProbes::kPoints> rays{}, shown{};
  bool any = as_shown > 0;
  for (const GroundHit& hit : ground_probes_.hits(index)) {
    if (!hit.bake_blocks) continue;
    rays[hit.point].g += 1;
    rays[hit.point].b += hit.inside;
    if (!hit.object_first) {
      rays[hit.point].r += 1;
      any = true;
    } else if (as_shown > 0 && !hit.inside) {
      shown[hit.point] += exit_of_object(index, hit.vertex) * kPerRay;
    }
  }
  if (!any) return;
  RadianceSh reflected = light.local.with_bands(baked.reflected.bands);
  if (lights && lit.empty())
    for (int n = 0; n < reflected.size(); ++n) reflected[n] += light.lights[n];
  o.more.resize(std::max(o.more.size(), o.deficit.size()));
  const std::span<float> more(o.more.data(), o.deficit.size());
  relight_reflected(o, PreparedObject::TransferPart::kGround, reflected, more);
  if (lights && !lit.empty()) add_ground_reflected(o, light.lights, lit, more);
  const int size = baked.receiver->grid.size;
  std::array<Rgb, GroundProbes::kPoints> expected{};
  for (std::size_t p = 0; p < expected.size(); ++p) {
    expected[p] = in_middle_of(p, size, more);
    if (rays[p].b * kPerRay > .5f) shown[p] = expected[p];  // within the object
  }
  const Scratch::Scope scope;
  const auto on_texels = [&](std::span<const Rgb, GroundProbes::kPoints> of_points) {
    std::pmr::vector<float> out(o.deficit.size(), 0.f, scope.memory());
    ground_probes_.spread(index, of_points, size, out);
    return out;
  };
  const auto met = on_texels(rays), sent = on_texels(shown), baked_there = on_texels(expected);
  const std::size_t stride = more.size() / 3;
  for (std::size_t i = 0; i < more.size(); ++i) {
    const float stopped = met[i % stride], all = met[stride + i % stride];
    const float past = stopped > 0 ? 1 - stopped / all : 1;
    const float kept = baked_there[i] > 0 ? std::min(sent[i] / baked_there[i], 1.f) : 1;
    const float added = std::max(sent[i] - std::max(baked_there[i], 0.f), 0.f);
    o.deficit[i] += more[i] * (1 - std::lerp(past, kept, as_shown)) - as_shown * added;
  }
}

// What real things have lost is of all objects together: the nearest takes it from a place of the
// floor, in the measure of its grid. Several in one place all do, and have it in common
// (combine_shadows).
bool CompositeStage::is_nearest(std::size_t index, const glm::dvec3& place) const {
  const auto distance = [&](std::size_t k) {
    const auto& receiver = objects_[k].prepared->baked.receiver;
    return receiver
               ? glm::length(place - floor_of(k).translation) / double(receiver->grid.half_extent)
               : std::numeric_limits<double>::max();
  };
  constexpr double kSame = 1e-3;
  for (std::size_t k = 0; k < objects_.size(); ++k)
    if (distance(k) < distance(index) - kSame) return false;
  return true;
}

}  // namespace penumbra::runtime
