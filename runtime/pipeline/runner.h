// Drives a frame source through the two stages: in order of time for replay, on threads when live.
#pragma once

#include <atomic>
#include <functional>
#include <optional>

#include "capture/frames.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"
#include "runtime/pipeline/runs.h"

namespace penumbra::runtime {

class CompositeStage;
class LightEstimationStage;

/// What others may change and watch while a live run goes on. Each may be empty.
struct LiveChanges {
  // On the compositing thread, at least twice a second
  std::function<void()> turn;
  // There as well, before each frame; the second only after the first said so. What was drawn with
  // the stage before has been handed out by then.
  std::function<bool()> stage_waits;
  std::function<CompositeStage*()> take_stage;  // warm, keeping time; null: the one before goes on
  // On the light's thread, before and after each environment frame. The last is given the light
  // once it is whole, with the lights as well that frames have no time for.
  std::function<std::optional<lighting::GovernorConfig>()> take_governor;
  std::function<std::optional<lighting::SurfaceRoughness>()> take_mirror{};
  std::function<void(const LightEstimationStage&, const lighting::LightEstimate&)> on_light;
};

/// Every frame in order of time on this thread: the same input gives the same bytes.
/// errors: what the source and the stages say; kUndetermined when no environment frame ever gave
/// light
Result<RunCounts> run_replay(capture::FrameSource& source, LightEstimationStage& light,
                             CompositeStage& compose, const Sink& sink, StageTimes& times);

/// The source on one thread (paced to its timestamps), the light on another, compositing on this
/// one; they meet in mailboxes, one slot a camera and exposure. Where frames take longer than the
/// source's view_rate allows, the governor's lights are given up one by one, and taken back when
/// there is time (FrameBudget). Stops when the source ends, the sink says so, or `stop` is set.
Result<RunCounts> run_live(capture::FrameSource& source, LightEstimationStage& light,
                           CompositeStage& compose, const Sink& sink, StageTimes& times,
                           const std::atomic<bool>& stop, const LiveChanges& changes = {});

}  // namespace penumbra::runtime
