// The part of CompositeStage that tells what an object changes on the floor beside real things.
#include <algorithm>
#include <array>
#include <limits>
#include <span>

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

// What the object reflects onto the floor does not go through real things.
void CompositeStage::take_hidden_reflections(std::size_t index, const RadianceSh& local,
                                             const RadianceSh* lights) {
  StageObject& o = objects_[index];
  const prt::BakedObject& baked = o.prepared->baked;
  // Of a point's rays that meet the object, how many a real thing stops first, and all.
  std::array<Rgb, GroundProbes::kPoints> rays{};
  bool any = false;
  for (const GroundHit& hit : ground_probes_.hits(index)) {
    if (!hit.bake_blocks) continue;
    rays[hit.point].g += 1;
    if (hit.object_first) continue;
    rays[hit.point].r += 1;
    any = true;
  }
  if (!any) return;
  o.rays.assign(o.deficit.size(), 0);
  ground_probes_.spread(index, rays, baked.receiver->grid.size, o.rays);
  RadianceSh reflected = local.with_bands(baked.reflected.bands);
  if (lights)
    for (int n = 0; n < reflected.size(); ++n) reflected[n] += (*lights)[n];
  o.more.resize(std::max(o.more.size(), o.deficit.size()));
  const std::span<float> more(o.more.data(), o.deficit.size());
  relight_reflected(o, PreparedObject::TransferPart::kGround, reflected, more);
  const std::size_t stride = more.size() / 3;
  for (std::size_t texel = 0; texel < stride; ++texel) {
    const float stopped = o.rays[texel], all = o.rays[stride + texel];
    if (stopped <= 0) continue;
    for (std::size_t c = 0; c < 3; ++c)
      o.deficit[c * stride + texel] += stopped / all * more[c * stride + texel];
  }
}

// What real things have lost is of all objects together: the nearest takes it from a place of the
// floor, in the measure of its grid. Several in one place all do, and have it in common
// (combine_shadows).
bool CompositeStage::is_nearest(std::size_t index, const glm::dvec3& place) const {
  const auto distance = [&](std::size_t k) {
    const auto& receiver = objects_[k].prepared->baked.receiver;
    return receiver
               ? glm::length(place - poses_[k].translation) / double(receiver->grid.half_extent)
               : std::numeric_limits<double>::max();
  };
  constexpr double kSame = 1e-3;
  for (std::size_t k = 0; k < objects_.size(); ++k)
    if (distance(k) < distance(index) - kSame) return false;
  return true;
}

}  // namespace penumbra::runtime
