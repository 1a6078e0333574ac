// What cameras see of the surroundings as a track of maps: merged once, kept in a hundredth of the
// bytes, replayed without the cameras' frames.
// threads: thread-bound, as every FrameSource
#pragma once

#include <memory>
#include <string_view>

#include "capture/frames.h"
#include "core/result.h"

#pragma GCC visibility push(default)
namespace penumbra::runtime {

/// What a recording keeps of the light.
enum class KeptLight {
  kCameras,  // frames of the cameras that show the surroundings
  kTrack,    // maps that are measured from them
  kBoth,
};
/// Names as in options: cameras, track, both.
/// errors: kInvalid naming the known ones
Result<KeptLight> kept_light(std::string_view name);

/// Maximum number of rows of a track's maps where nothing else is asked for, pixels of 1.4 degrees:
/// enough for shadows and matt objects. A mirror shows finer ones.
inline constexpr int kLightTrackRows = 128;

/// The source's frames, and behind each of the surroundings the map as it is then. The track is the
/// last of the cameras. With kTrack the frames that show the surroundings alone are left out.
/// in:     source: outlives this. max_rows: finer maps are averaged down, by halves; those of a
///         track that the source has only as often as their rows are even
/// errors: kInvalid (no camera shows the surroundings, max_rows not within 16..1024)
/// next(): as source's and LightEstimationStage::assemble's
Result<std::unique_ptr<capture::FrameSource>> with_light_track(capture::FrameSource& source,
                                                               KeptLight keep,
                                                               int max_rows = kLightTrackRows);

}  // namespace penumbra::runtime
#pragma GCC visibility pop
