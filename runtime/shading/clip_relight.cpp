// How a part of an object is relit: by which of the machine's processors, from coefficients or from components.

#include <spdlog/spdlog.h>

#include "prt/clip/sequence.h"
#include "runtime/scene/scene.h"
#include "runtime/shading/composite_stage.h"
#include "runtime/shading/median_time.h"

namespace penumbra::runtime {

namespace {

using TransferPart = PreparedObject::TransferPart;
constexpr int kTimings = 5;

// Every band lit, and a time between frames: about what a moment costs at most.
RadianceSh some_light(int bands) {
  RadianceSh light(bands);
  for (int n = 0; n < light.size(); ++n) light[n] = {1, 1, 1};
  return light;
}

}  // namespace

void CompositeStage::keep_time() {
  keeps_time_ = true;
  for (StageObject& o : objects_) choose_device(o);
}

// Both are timed before the first frame, with the transfer that they will have to sum. The CPU does what the device does not
// do faster, or at all.
void CompositeStage::choose_device(StageObject& o) {
  if (!o.prepared->animation || o.prepared->animation->live) return;
  for (std::size_t i = 0; i < PreparedObject::kParts; ++i) {
    const auto part = static_cast<TransferPart>(i);
    const prt::TransferSequence& clip = o.prepared->clip_of(part);
    if (clip.points() == 0) continue;
    const auto on_gpu = compositor_->add_clip(clip);
    if (!on_gpu) {
      if (part == TransferPart::kSurface)
        spdlog::info("{}: relit on the CPU: {}", o.prepared->name, on_gpu.error().detail);
      continue;
    }
    const RadianceSh light = some_light(clip.bands());
    const auto turns = o.prepared->turns_of(part);
    std::vector<float> out(3 * clip.stride());
    bool works = true;
    const double cpu_ms = median_ms(kTimings, [&] { clip.relight(.5, light, turns, out); });
    const double gpu_ms = median_ms(kTimings, [&] {
      works &= compositor_->relight(*on_gpu, .5, light, turns, out).has_value();
    });
    const bool gpu = works && gpu_ms < cpu_ms;
    if (gpu)
      o.on_gpu[i] = *on_gpu;
    else
      compositor_->remove_clip(*on_gpu);
    if (part != TransferPart::kSurface) continue;
    if (works)
      spdlog::info("{}: relit on the {}: CPU {:.2f} ms, {} {:.2f} ms", o.prepared->name,
                   gpu ? "GPU" : "CPU", cpu_ms, compositor_->renderer(), gpu_ms);
    else
      spdlog::info("{}: relit on the CPU: {} failed", o.prepared->name, compositor_->renderer());
  }
}

void CompositeStage::relight_part(StageObject& o, TransferPart part, const RadianceSh& light,
                                  std::span<float> out) const {
  const PreparedObject& p = *o.prepared;
  std::optional<int>& clip = o.on_gpu[static_cast<std::size_t>(part)];
  if (clip) {
    const auto done = compositor_->relight(*clip, p.frame, light, p.turns_of(part), out);
    if (done) return;
    spdlog::warn("{}: relit on the CPU from now on: {}", p.name, done.error().detail);
    clip.reset();
  }
  p.relight(part, light, out);
}

// A surface or the ground, and what of `reflected` comes to it by reflection.
void CompositeStage::relight_parts(StageObject& o, TransferPart own, const RadianceSh& light,
                                   const RadianceSh* reflected, std::span<float> out) const {
  const bool surface = own == TransferPart::kSurface;
  if (o.patterns)
    return (surface ? o.patterns->surface : o.patterns->ground).relight(light, reflected, out);
  relight_part(o, own, light, out);
  if (!reflected) return;
  o.more.resize(out.size());
  relight_part(o, surface ? TransferPart::kReflected : TransferPart::kGroundReflected, *reflected,
               o.more);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] += o.more[i];
}

}  // namespace penumbra::runtime
