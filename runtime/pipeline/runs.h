// What a run over many frames hands out and counts.
// threads: plain values
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>

#include "capture/frames.h"
#include "core/threads/processor_time.h"
#include "lighting/governor.h"
#include "lighting/light_estimate.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// Frames of a live run that newer ones overtook, by the queue in which they waited.
struct OvertakenFrames {
  std::uint64_t view = 0;         // while another one was composited
  std::uint64_t environment = 0;  // while the light was measured
  std::uint64_t foreground = 0;   // of depth cameras and masks, while another one was composited
  std::uint64_t for_light = 0;    // exposures of a view camera for the light alone, likewise
  // Eyes whose other one did not come; some were shown alone
  std::uint64_t unmatched_eyes = 0;
  std::uint64_t all() const { return view + environment + foreground + for_light; }
};

struct RunCounts {
  std::uint64_t frames = 0;         // view frames handed out
  std::uint64_t without_light = 0;  // of them passed through, since no light was measured yet
  OvertakenFrames overtaken;
  // Environment frames all black or all clipped; live also damaged frames
  std::uint64_t unusable = 0;
  double touched = 0;  // sum of the touched fractions
  double seconds = 0;
  std::optional<ProcessorTimes> processor;  // that a live run took
  int lights = 0;                           // most that lit a frame
  std::optional<double> coverage;           // of the sphere, least that lit a frame
  std::optional<lighting::Plan> plan;       // the governor's last
  int exposures = 0;                        // distinct exposures of the environment camera
};

/// One composited view frame with the frame that it came from and the light that it was drawn with.
struct Output {
  const capture::Frame& source;
  std::shared_ptr<const FramePixels> pixels;
  const lighting::LightEstimate& light;
  OvertakenFrames overtaken;  // so far
};
/// False stops the run.
using Sink = std::function<bool(const Output&)>;

}  // namespace penumbra::runtime
#pragma GCC visibility pop
