// The ways out that rig.toml names, of each kind one at most.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "core/image.h"
#include "core/result.h"
#include "core/units.h"
#include "service/outputs/frame_output.h"

namespace penumbra::service {

/// threads: thread-bound; others are opened and closed on a thread of its own, which no frame waits
/// for
class OutputSet {
 public:
  static constexpr std::array<std::string_view, 3> kKinds = {"pipewire", "v4l2", "y4m"};
  /// By kind: where the picture goes; empty: not there.
  using Targets = std::array<std::string, kKinds.size()>;

  /// rate_hz: of the source, frames a second
  /// errors: as FrameOutput; those before stay open
  Result<void> open(const Targets& targets, double rate_hz);
  /// Opens, soon, what goes elsewhere than before and then closes what was there; one that has
  /// ended is opened again, but for y4m, whose film it would begin anew. One that cannot be opened
  /// leaves what was there. The log tells all of it.
  void change(const Targets& targets);

  /// Never waits for an output. captured: rises from frame to frame
  void show(const std::shared_ptr<const FramePixels>& pixels, TimestampNs captured);
  struct State {
    std::string name;
    FrameOutput::OutputCounts counts;
    std::string trouble;  // empty while all is well
  };
  /// Of those that are open.
  std::vector<State> states() const;

 private:
  static Result<std::unique_ptr<FrameOutput>> make(std::size_t kind, const std::string& target,
                                                   double rate_hz);
  void change_one(std::size_t kind, const std::string& target);

  double rate_hz_ = 0;
  mutable std::mutex mutex_;
  Targets targets_;  // guarded by mutex_, as what follows
  std::array<std::unique_ptr<FrameOutput>, kKinds.size()> outputs_;  // null: not there
  std::jthread changing_;  // last: joined before the rest goes
};

}  // namespace penumbra::service
