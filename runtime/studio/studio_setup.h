// The built-in studio as demo and serve use it.
// threads: reentrant
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "capture/studio/studio.h"
#include "capture/studio/world.h"
#include "runtime/scene/scene.h"

namespace penumbra::runtime {

struct StudioSetup {
  std::shared_ptr<const capture::RadianceWorld> world;
  capture::StudioOptions options;
  Scene scene;
};

struct StudioRequest {
  std::optional<std::string> environment{}, asset{}, animation{}, real_mesh{};
  double environment_rotation_deg = 0;  // about the vertical, counter-clockwise seen from above
  bool animated = true;
  int width = 1280, height = 720;
  double fps = 30;
  int frames = 90;
  int clip = 0;
};

/// Environment (the built-in room without one), cameras and the scene: an object (the knot, or the
/// asset, half a metre large; with a clip .8 m) and a turning one, with a real thing among them if
/// one is wanted.
Result<StudioSetup> set_up_studio(
    const StudioRequest& request,
    const std::function<std::function<void(double)>(const std::string&)>& progress);

}  // namespace penumbra::runtime
