// How a part of an object is relit: from coefficients or from components.

#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"

namespace penumbra::runtime {

using TransferPart = PreparedObject::TransferPart;

// A surface or the ground, and what of `reflected` comes to it by reflection.
void CompositeStage::relight_parts(StageObject& o, TransferPart own, const RadianceSh& light,
                                   const RadianceSh* reflected, std::span<float> out) const {
  const bool surface = own == TransferPart::kSurface;
  if (o.bases) return (surface ? o.bases->surface : o.bases->ground).relight(light, reflected, out);
  o.prepared->relight(own, light, out);
  if (!reflected) return;
  o.more.resize(out.size());
  o.prepared->relight(surface ? TransferPart::kReflected : TransferPart::kGroundReflected,
                      *reflected, o.more);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] += o.more[i];
}

}  // namespace penumbra::runtime
