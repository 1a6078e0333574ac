// The part of CompositeStage that lights objects that are lifted off their floor or lean. Their
// bake knows them on it: here the object alone is relit, by a light that has the floor in it.
#include <memory>
#include <utility>

#include "core/threads/parallel.h"
#include "prt/geometry/mesh.h"
#include "prt/transfer/relight.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {

namespace {

void add(RadianceSh& sum, const RadianceSh& more) {
  for (int n = 0; n < sum.size(); ++n) sum[n] += more[n];
}

}  // namespace

void CompositeStage::begin_lifted(StageObject& o) {
  if (o.lifted) return;
  o.lifted = std::make_unique<Lifted>();
  const prt::BakedObject& baked = o.prepared->baked;
  for (const StageObject& other : objects_)
    if (other.lifted && other.bases == o.bases && other.lifted->free)
      o.lifted->free = other.lifted->free;
  if (!o.lifted->free)
    o.lifted->free = std::make_shared<FreeTransfer>(baked.mesh, baked.transfer.bands);
}

void CompositeStage::await_lifted() {
  for (std::size_t i = 0; i < objects_.size(); ++i) {
    if (!moves_.is_lifted(i)) continue;
    begin_lifted(objects_[i]);
    objects_[i].lifted->free->wait();
  }
}

// What is new of objects that are off their floor or lean. A run that does not keep time has their
// transfer at once, so that its pictures are the same on every machine.
void CompositeStage::look_at_lifted() {
  for (std::size_t i = 0; i < objects_.size(); ++i) {
    StageObject& o = objects_[i];
    if (!o.lifted_now || !o.visible) continue;
    begin_lifted(o);
    Lifted& lifted = *o.lifted;
    if (!keeps_time_) lifted.free->wait();
    const StageTimer timer(times_, "lifted objects");
    if (lifted.ground.look(*lights_.occluders().virtual_things, static_cast<int>(i),
                           o.prepared->baked, poses_[i], floors_[i])) {
      const glm::dmat3 turn = (floors_[i].inverse() * poses_[i]).rotation_matrix();
      lifted.to_bake = lighting::ShRotation(glm::transpose(turn), prt::kReflectedBands);
      o.other_stance = true;
    }
    const bool ready = lifted.free->ready();
    if (ready != std::exchange(lifted.used_free, ready)) o.other_stance = true;
  }
}

// The surface, and what of `reflected` comes to it by reflection. Until the object's own transfer
// is known its bake's is turned with it: floor and all.
void CompositeStage::relight_lifted(StageObject& o, const RadianceSh& light,
                                    const RadianceSh* reflected, std::span<float> out) const {
  const Lifted& lifted = *o.lifted;
  if (!lifted.used_free) {
    const RadianceSh turned = reflected ? lifted.to_bake * *reflected : RadianceSh(1);
    return o.bases->surface.relight(lifted.to_bake * light, reflected ? &turned : nullptr, out);
  }
  auto around = lifted.ground.from_floor(light, o.prepared->baked.receiver->albedo);
  const RadianceSh above = LiftedGround::from_above(light);
  for (RadianceSh& at_place : around) add(at_place, above);
  if (!reflected) return relight_from_places(o, around, out);
  const auto again = lifted.ground.from_floor(*reflected, o.prepared->baked.receiver->albedo);
  for (std::size_t k = 0; k < around.size(); ++k) add(around[k], again[k]);
  relight_from_places(o, around, out);
  add_own_reflection(o, *reflected, out);
}

// What comes by reflection alone: from the floor to all of it, and between its own parts.
void CompositeStage::relight_lifted_reflected(const StageObject& o, const RadianceSh& light,
                                              std::span<float> out) const {
  const Lifted& lifted = *o.lifted;
  if (!lifted.used_free) return o.bases->surface.relight_second(lifted.to_bake * light, out);
  relight_from_places(o, lifted.ground.from_floor(light, o.prepared->baked.receiver->albedo), out);
  add_own_reflection(o, light, out);
}

// Under what each of the places sees, mixed by how near vertices are to them.
void CompositeStage::relight_from_places(
    const StageObject& o, const std::array<RadianceSh, LiftedGround::kPlaces>& around,
    std::span<float> out) const {
  const prt::Mesh& mesh = o.prepared->baked.mesh;
  const prt::Bounds bounds = prt::bounds_of(mesh);
  const std::size_t stride = out.size() / 3, vertices = mesh.positions.size();
  thread_local std::array<std::vector<float>, LiftedGround::kPlaces> memory;  // grows once
  auto& at = memory;
  parallel_for(std::size_t{0}, at.size(), [&](std::size_t k) {
    at[k].resize(out.size());
    prt::relight(o.lifted->free->surface(), o.lifted->to_bake * around[k], at[k]);
  });
  constexpr std::size_t kVerticesAtOnce = 1024;
  parallel_for(std::size_t{0}, vertices, kVerticesAtOnce, [&](const auto& some) {
    for (std::size_t v = some.begin(); v < some.end(); ++v) {
      const auto weights = LiftedGround::weights(bounds, mesh.positions[v]);
      for (std::size_t c = 0; c < 3; ++c) {
        float sum = 0;
        for (std::size_t k = 0; k < weights.size(); ++k) sum += weights[k] * at[k][c * stride + v];
        out[c * stride + v] = sum;
      }
    }
  });
}

void CompositeStage::add_own_reflection(const StageObject& o, const RadianceSh& light,
                                        std::span<float> out) {
  thread_local std::vector<float> own;  // grows once
  own.resize(out.size());
  prt::relight(o.lifted->free->reflected(), o.lifted->to_bake * LiftedGround::from_above(light),
               own);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] += own[i];
}

}  // namespace penumbra::runtime
