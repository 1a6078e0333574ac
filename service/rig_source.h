// What a rig.toml names as the source of frames: cameras, the studio, or a capture played in a
// loop.
// threads: reentrant
#pragma once

#include <memory>
#include <string>

#include "capture/frames.h"
#include "capture/poses/posed_source.h"
#include "core/result.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"
#include "service/scene/scene_keeper.h"

namespace penumbra::service {

struct RigSource {
  std::unique_ptr<capture::FrameSource> source;
  const capture::PosedSource* posed = nullptr;  // the same, where cameras move
  runtime::Scene scene;                         // the configuration's, else the studio's own
};

/// Times of frames that no camera takes now, of the studio and of captures.
enum class PlayedTimes { kAsTaken, kOfNow };

/// head: the poses of a headset, for a rig that asks for them
/// errors: as capture::Rig::open, capture::open_capture, set_up_studio, read_scene, with_poses
Result<RigSource> open_rig(const RigConfig& config, const ProgressOf& progress,
                           PlayedTimes times = PlayedTimes::kAsTaken,
                           std::unique_ptr<capture::PoseSource> head = nullptr);

}  // namespace penumbra::service
