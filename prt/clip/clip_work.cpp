// What the bake of a clip comes to: one frame of it is baked with few rays, and with more.
#include <algorithm>
#include <ctime>

#include "prt/clip/internal/frame_bake.h"
#include "prt/clip/sequence.h"

namespace penumbra::prt {

namespace {

constexpr int kFewRays = 64, kMoreRays = 320;

struct Times {
  double seconds = 0, core_seconds = 0;
};

// Core time is that of the process: what others compute beside it is not in there.
Result<Times> time_frame(const FrameBaker& baker) {
  const std::clock_t start = std::clock();
  PENUMBRA_ASSIGN(record, baker.bake(0, {}));
  return Times{record.seconds, static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC};
}

SequenceOptions with_rays(SequenceOptions options, int rays) {
  options.rays = options.ground_rays = rays;
  options.progress = nullptr;
  return options;
}

}  // namespace

Result<ClipWork> estimate_work(const Character& character, int clip,
                               const SequenceOptions& options) {
  const SequenceOptions few_options = with_rays(options, kFewRays);
  const SequenceOptions more_options = with_rays(options, kMoreRays);
  PENUMBRA_ASSIGN(few, FrameBaker::create(character, clip, few_options));
  PENUMBRA_ASSIGN(more, FrameBaker::create(character, clip, more_options));
  PENUMBRA_ASSIGN(first, few.bake(0, {}));  // wakes threads and touches memory
  PENUMBRA_ASSIGN(with_few, time_frame(few));
  PENUMBRA_ASSIGN(with_more, time_frame(more));
  ClipWork out;
  out.frames = few.frames();
  out.points = few.layout().points();
  const std::uint64_t texels = few.shape(FrameBaker::kGround).points;
  const auto rays_of = [&](int rays, int ground_rays) {
    return out.points * static_cast<std::uint64_t>(rays) +
           texels * static_cast<std::uint64_t>(ground_rays);
  };
  const std::uint64_t rays = rays_of(options.rays, options.ground_rays);
  const auto frames = static_cast<std::uint64_t>(out.frames);
  out.rays = frames * rays;
  out.journal_bytes = frames * first.values.size() * sizeof(first.values[0]);
  // Some of a frame's time is none of its rays'.
  const auto few_rays = static_cast<double>(rays_of(kFewRays, kFewRays));
  const auto more_rays = static_cast<double>(rays_of(kMoreRays, kMoreRays));
  const auto of_clip = [&](double few_s, double more_s) {
    const double ray_s = std::max(0., more_s - few_s) / (more_rays - few_rays);
    const double frame_s = more_s + ray_s * (static_cast<double>(rays) - more_rays);
    return out.frames * std::max(std::min(few_s, more_s), frame_s);
  };
  out.seconds = of_clip(with_few.seconds, with_more.seconds);
  out.core_seconds = of_clip(with_few.core_seconds, with_more.core_seconds);
  return out;
}

}  // namespace penumbra::prt
