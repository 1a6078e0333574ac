// The service's configuration, rig.toml.
// threads: reentrant
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "capture/device/rig.h"
#include "core/result.h"
#include "runtime/scene/scene.h"
#include "service/headset/headset.h"
#include "service/poses/pose_config.h"

namespace penumbra::service {

struct RigConfig {
  std::string source;  // "studio", "cameras", or the path of a capture folder, played in a loop
  std::vector<capture::RigCamera> cameras;
  std::optional<std::string> environment;  // of the studio
  std::optional<std::string> asset;        // of the studio's own scene
  std::optional<std::string> real_mesh;    // a real thing in the studio
  std::optional<std::string> scene;        // scene.toml; needed for a capture folder
  double fps = 30;                         // of the studio's view camera
  int width = 1280, height = 720;          // of the studio's view camera
  int bands = 5, max_lights = 8;           // at most
  double max_shadow_error = .05;           // RMS error of the shadow ratio
  double stale_after_s = 1;                // light older than this is reported as stale
  // Nothing: in the folder of this user's running programs, where there is one. Empty: none
  std::optional<std::filesystem::path> socket, light_page;
  bool socket_for_group = false;  // else its owner alone may open it
  std::string address = "127.0.0.1";
  std::optional<int> port;           // 0: any free one; nothing: no TCP
  std::string token;                 // of the token's file
  std::vector<std::string> origins;  // whose pages may read and change
  std::filesystem::path recordings;  // folder of recordings and snapshots
  std::string pipewire, v4l2, y4m;   // where the picture goes; empty: not there
  bool openxr = false;               // and into a headset
  HeadsetOptions headset{};
  std::optional<PoseConfig> pose;  // nothing: the cameras stand
  // The light of a map instead of an environment camera's
  std::optional<std::string> light_environment;
  std::optional<double> environment_scale;  // nothing: by the paper of the boards
  double paper_albedo = .8;
  std::optional<runtime::Scene> own_scene;  // instead of a file's
};

/// errors: kNotFound, kUnreadable, kInvalid (file, line, key; an address that is not loopback,
/// without a token)
/// to_composite: with a scene, an environment camera and a view camera; else any cameras do, and a
/// scene is not looked at.
Result<RigConfig> read_rig_config(const std::filesystem::path& path, bool to_composite = true);

}  // namespace penumbra::service
