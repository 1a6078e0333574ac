// A rig from what is on the table: a webcam, a printed board, a map of the light.
// threads: reentrant
#pragma once

#include <optional>
#include <string>

#include "core/result.h"
#include "service/rig_config.h"

namespace penumbra::service {

struct QuickStart {
  std::string source{};  // a camera, a recording or a capture folder; empty: the first camera
  std::string board = "charuco:8x6:0.03:0.022";
  std::string lens{};         // a camera file; empty: a guess
  std::string environment{};  // an HDR map; empty: a built-in room
  std::string asset = "builtin:knot";
  double size_m = .1;  // of the object
  int port = 8787;     // on this machine alone
};

/// The object in the middle of the board, which lies flat and is the world's floor.
/// errors: kNotFound (no camera here), kInvalid (the board, a size that is not above 0 and at most
///         10 m), as read_camera_file
Result<RigConfig> quick_rig(const QuickStart& quick);

}  // namespace penumbra::service
