// The ways out that rig.toml names, of each kind one at most.
// threads: thread-bound
#pragma once

#include <array>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "core/units.h"
#include "service/outputs/frame_output.h"

namespace penumbra::service {

class OutputSet {
 public:
  static constexpr std::array<std::string_view, 3> kKinds = {"pipewire", "v4l2", "y4m"};
  /// By key: where the picture goes; empty: not there.
  using Targets = std::array<std::string, kKinds.size()>;

  /// rate_hz: of the source, frames a second
  /// errors: as FrameOutput; those before stay open
  Result<void> open(const Targets& targets, double rate_hz);
  /// Closes and opens those that go elsewhere than before, and says so in the log, errors too: one
  /// that cannot be opened is missing from then on.
  void change(const Targets& targets);

  /// Never waits. captured: rises from frame to frame
  void show(const std::shared_ptr<const FramePixels>& pixels, TimestampNs captured);
  /// Of those that are open.
  std::vector<const FrameOutput*> all() const;

 private:
  Result<void> open_one(std::size_t kind, const std::string& target);
  double rate_hz_ = 0;
  Targets targets_;
  std::array<std::unique_ptr<FrameOutput>, kKinds.size()> outputs_;  // null: not there
};

}  // namespace penumbra::service
