// What a rig.toml names as the source of frames: cameras, the studio, or a capture played in a
// loop.
// threads: reentrant
#pragma once

#include <memory>
#include <string>

#include "capture/frames.h"
#include "core/result.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"
#include "service/scene/scene_keeper.h"

namespace penumbra::service {

struct RigSource {
  std::unique_ptr<capture::FrameSource> source;
  runtime::Scene scene;  // the configuration's, else the studio's own
};

/// errors: as capture::Rig::open, capture::open_capture, set_up_studio, read_scene
Result<RigSource> open_rig(const RigConfig& config, const ProgressOf& progress);

}  // namespace penumbra::service
