// Drives a frame source through the two stages: in order of time for replay, on threads when live.
#pragma once

#include <atomic>

#include "capture/frames.h"
#include "core/result.h"
#include "core/threads/stage_times.h"
#include "runtime/pipeline/runs.h"

namespace penumbra::runtime {

class CompositeStage;
class LightEstimationStage;

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
                           const std::atomic<bool>& stop);

}  // namespace penumbra::runtime
