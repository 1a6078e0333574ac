// Camera models and poses from the files of other programs and devices.
// threads: reentrant
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/camera_model.h"
#include "core/pose.h"
#include "core/result.h"
#include "core/units.h"

namespace penumbra::calib {

/// One camera in Penumbra's conventions (conventions.h). The files count pixels from the first
/// one's centre and have cameras that look along +z with y down; both are converted.
struct ImportedCamera {
  std::string name;
  std::string eye;  // "left", "right" or empty
  CameraModel camera;
  std::optional<Pose> body_from_camera;
  // t_body = t_camera + offset, where the file tells it
  std::optional<Seconds> clock_offset{};
};
/// One whose lens cannot be had.
struct UnknownCamera {
  std::string name;
  Error error;
};

struct ImportedRig {
  std::string format;  // as a reader knows it: "Kalibr camchain", say
  std::string body;    // of body_from_camera: "head", "imu" or "first camera"; empty without poses
  std::vector<ImportedCamera> cameras;   // one at least
  std::vector<UnknownCamera> unknown{};  // of a file that has others
  std::vector<std::string> notes{};      // what was taken for something, and may be something else
};

/// Knows the format by its content: the Valve Index's config.json, Kalibr's camchain.yaml, Basalt's
/// calibration.json, a camera_info of ROS as YAML, or a FileStorage of OpenCV as YAML, XML or JSON.
/// errors: kNotFound, kUnreadable, kInvalid (file, camera, key; a model that Penumbra has not, by
///         name)
Result<ImportedRig> import_camera(const std::filesystem::path& path);

/// Such a file's text; `path` names it in errors.
Result<ImportedRig> parse_camera_import(std::string_view text, const std::filesystem::path& path);

}  // namespace penumbra::calib
