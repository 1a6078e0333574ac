// One [[camera]] table, read as capture.toml, rig.toml and camera files share it.
// threads: reentrant
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/response.h"
#include "capture/frames.h"
#include "capture/recording/folder_format.h"
#include "core/io/toml_keys.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

inline constexpr std::array<std::string_view, 25> kCameraKeys{"name",
                                                              "role",
                                                              "eye",
                                                              "width",
                                                              "height",
                                                              "projection",
                                                              "focal_px",
                                                              "principal_px",
                                                              "distortion",
                                                              "intrinsics",
                                                              "response",
                                                              "black_level",
                                                              "white_balance",
                                                              "frames",
                                                              "world_from_camera",
                                                              "full_well_electrons",
                                                              "read_noise",
                                                              "psf_sigma_px",
                                                              "colour",
                                                              "pose",
                                                              "noise",
                                                              "lens",
                                                              "ball",
                                                              "vignetting",
                                                              "depth_unit_m"};

/// All of a camera but its frames and, since that may depend on them, its response and its white
/// balance. Keys are the caller's to check.
/// errors: kNotFound, kUnreadable, kInvalid (file, line, key)
Result<CameraInfo> read_camera_info(const TomlKeys& keys);

/// What is wrong with a key of light of a camera that sees none.
std::string no_light(Role role);

/// Codes mean nothing without a response; float frames need none.
/// in: a camera that sees light
Result<calib::Response> read_response(const TomlKeys& keys, const std::vector<FrameRow>& rows);
Result<void> read_white_balance(const TomlKeys& keys, calib::Response& response);

}  // namespace penumbra::capture
#pragma GCC visibility pop
