// How a part of an object is relit: from coefficients or from components.

#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {

using TransferPart = PreparedObject::TransferPart;

// A surface or the ground, and what of `reflected` comes to it by reflection.
void CompositeStage::relight_parts(StageObject& o, TransferPart own, const RadianceSh& light,
                                   const RadianceSh* reflected, std::span<float> out) const {
  if (o.lifted_now && own == TransferPart::kSurface)
    return relight_lifted(o, light, reflected, out);
  if (o.bases) return o.bases->of(own).relight(light, reflected, out);
  o.prepared->relight(own, light, out);
  if (!reflected) return;
  o.more.resize(out.size());
  relight_reflected(o, own, *reflected, o.more);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] += o.more[i];
}

// What comes to a surface or to the ground by reflection alone.
void CompositeStage::relight_reflected(const StageObject& o, TransferPart own,
                                       const RadianceSh& light, std::span<float> out) const {
  if (o.lifted_now && own == TransferPart::kSurface) return relight_lifted_reflected(o, light, out);
  if (o.bases) return o.bases->of(own).relight_second(light, out);
  o.prepared->relight(
      own == TransferPart::kSurface ? TransferPart::kReflected : TransferPart::kGroundReflected,
      light, out);
}

}  // namespace penumbra::runtime
