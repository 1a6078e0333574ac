// The service's configuration with its cameras, and the table of a tracker.
#include "capture/poses/pose_track.h"
#include "service/rig_config.h"
#include "tests/fuzz/file_input.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace penumbra;
  const auto path = test::as_file({data, size}, ".toml");
  for (const bool to_composite : {true, false})
    if (const auto config = service::read_rig_config(path, to_composite))
      for (const auto& camera : config->cameras)
        if (camera.info.projection.width < 1 || !(camera.settings.fps > 0)) __builtin_trap();
  if (const auto tracker = capture::read_pose_track(path))
    if (tracker->empty()) __builtin_trap();
  return 0;
}
