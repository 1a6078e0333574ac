// What a rig.toml names as the source of frames: cameras, the studio, or a capture played in a
// loop.
// threads: reentrant
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "capture/frames.h"
#include "core/result.h"
#include "runtime/scene/scene.h"
#include "service/rig_config.h"

namespace penumbra::service {

/// Makes what is told how far a piece of work, by its name, has come.
using ProgressOf = std::function<std::function<void(double)>(const std::string&)>;

struct RigSource {
  std::unique_ptr<capture::FrameSource> source;
  runtime::Scene scene;  // the configuration's, else the studio's own
};

/// errors: as capture::Rig::open, capture::open_capture, set_up_studio, read_scene
Result<RigSource> open_rig(const RigConfig& config, const ProgressOf& progress);

}  // namespace penumbra::service
