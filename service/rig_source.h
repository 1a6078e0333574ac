// What a rig.toml names as the source of frames: cameras, the studio, or a capture played in a loop.
#pragma once

#include <memory>

#include "capture/frames.h"
#include "core/result.h"
#include "service/rig_config.h"
#include "runtime/scene/scene.h"

namespace penumbra::service {

struct RigSource {
  std::unique_ptr<capture::FrameSource> source;
  Scene scene;  // the configuration's, else the studio's own
};

/// errors: as capture::Rig::open, capture::open_capture, set_up_studio, read_scene
Result<RigSource> open_rig(const RigConfig& config);

}  // namespace penumbra::service
