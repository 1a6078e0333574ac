#include "service/outputs/output_set.h"

#include <exception>
#include <utility>

#include "core/exceptions.h"
#include "core/io/log.h"

namespace penumbra::service {

Result<std::unique_ptr<FrameOutput>> OutputSet::make(std::size_t kind, const std::string& target,
                                                     double rate_hz) {
  if (target.empty()) return nullptr;
  if (kKinds[kind] == "pipewire")
    return FrameOutput::to_pipewire({.name = target, .rate_hz = rate_hz});
  return kKinds[kind] == "v4l2" ? FrameOutput::to_v4l2(target)
                                : FrameOutput::to_y4m(target, rate_hz);
}

Result<void> OutputSet::open(const Targets& targets, double rate_hz) {
  rate_hz_ = rate_hz;
  for (std::size_t kind = 0; kind < kKinds.size(); ++kind) {
    PENUMBRA_ASSIGN(output, make(kind, targets[kind], rate_hz));
    const std::scoped_lock lock(mutex_);
    outputs_[kind] = std::move(output);
    targets_[kind] = targets[kind];
  }
  return {};
}

void OutputSet::change_one(std::size_t kind, const std::string& target) {
  std::unique_ptr<FrameOutput> before;  // ends outside the lock
  {
    const std::scoped_lock lock(mutex_);
    const bool again = outputs_[kind] && outputs_[kind]->ended() && kKinds[kind] != "y4m";
    if (target == targets_[kind] && !again) return;
    if (again) before = std::move(outputs_[kind]);
  }
  before.reset();  // it may hold what is opened now
  auto made = make(kind, target, rate_hz_);
  if (!made)
    return log_warning("output.{} stays as it is: {}: {}", kKinds[kind], made.error().where,
                       made.error().detail);
  {
    const std::scoped_lock lock(mutex_);
    before = std::exchange(outputs_[kind], std::move(*made));
    targets_[kind] = target;
  }
  if (target.empty())
    log_info("output.{} is closed", kKinds[kind]);
  else
    log_info("output.{} is {}", kKinds[kind], target);
}

void OutputSet::change(const Targets& targets) {
  changing_ = std::jthread([this, targets] {
    try {
      for (std::size_t kind = 0; kind < kKinds.size(); ++kind) change_one(kind, targets[kind]);
    } catch (const std::exception& e) {
      log_warning("the outputs stay as they are: {}", reason_of(e));
    }
  });
}

void OutputSet::show(const std::shared_ptr<const FramePixels>& pixels, TimestampNs captured) {
  const std::scoped_lock lock(mutex_);
  for (const auto& output : outputs_)
    if (output) output->show(pixels, captured);
}

std::vector<OutputSet::State> OutputSet::states() const {
  const std::scoped_lock lock(mutex_);
  std::vector<State> out;
  for (const auto& output : outputs_)
    if (output) out.push_back({output->name(), output->counts(), output->trouble()});
  return out;
}

}  // namespace penumbra::service
