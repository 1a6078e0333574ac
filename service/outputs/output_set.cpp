#include "service/outputs/output_set.h"

#include "core/io/log.h"

namespace penumbra::service {

Result<void> OutputSet::open_one(std::size_t kind, const std::string& target) {
  targets_[kind].clear();  // one that fails is tried again the next time
  outputs_[kind].reset();  // it may be where the new one goes
  if (target.empty()) return {};
  auto made = kKinds[kind] == "pipewire"
                  ? FrameOutput::to_pipewire({.name = target, .rate_hz = rate_hz_})
              : kKinds[kind] == "v4l2" ? FrameOutput::to_v4l2(target)
                                       : FrameOutput::to_y4m(target, rate_hz_);
  PENUMBRA_ASSIGN(output, std::move(made));
  outputs_[kind] = std::move(output);
  targets_[kind] = target;
  return {};
}

Result<void> OutputSet::open(const Targets& targets, double rate_hz) {
  rate_hz_ = rate_hz;
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind)
    PENUMBRA_TRY(open_one(kind, targets[kind]));
  return {};
}

void OutputSet::change(const Targets& targets) {
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    if (targets[kind] == targets_[kind]) continue;
    if (const auto opened = open_one(kind, targets[kind]); !opened)
      log_warning("output.{} is missing: {}: {}", kKinds[kind], opened.error().where,
                  opened.error().detail);
    else if (targets[kind].empty())
      log_info("output.{} is closed", kKinds[kind]);
    else
      log_info("output.{} is {}", kKinds[kind], targets[kind]);
  }
}

void OutputSet::show(const std::shared_ptr<const FramePixels>& pixels, TimestampNs captured) {
  for (const auto& output : outputs_)
    if (output) output->show(pixels, captured);
}

std::vector<const FrameOutput*> OutputSet::all() const {
  std::vector<const FrameOutput*> out;
  for (const auto& output : outputs_)
    if (output) out.push_back(output.get());
  return out;
}

}  // namespace penumbra::service
