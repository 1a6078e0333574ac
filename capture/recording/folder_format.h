// The two text files of a capture folder, read and printed.
// threads: reentrant
#pragma once

#include <toml++/toml.h>

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/response.h"
#include "capture/frames.h"
#include "core/units.h"

#pragma GCC visibility push(default)
namespace penumbra::capture {

/// One line of a camera's frame list.
struct FrameRow {
  std::string file;  // relative to the folder
  TimestampNs time;
  Exposure exposure;
  std::optional<Pose> pose;
  float opacity = 1;  // as of Frame
};

struct FolderCamera {
  CameraInfo info;
  std::vector<FrameRow> rows;
};

inline constexpr std::string_view kManifestName = "capture.toml";
inline constexpr std::string_view kListHeader = "file,time_s,exposure_s,gain";
inline constexpr std::string_view kPoseHeader = ",tx,ty,tz,qx,qy,qz,qw";
inline constexpr std::string_view kOpacityHeader = ",opacity";  // behind a pose

/// Reads capture.toml and every camera's frame list.
/// errors: as open_capture_folder
Result<std::vector<FolderCamera>> read_manifest(const std::filesystem::path& folder);

/// capture.toml's text. `responses`: what each camera's response key says.
std::string print_manifest(const std::vector<CameraInfo>& cameras,
                           const std::vector<std::string>& responses);

/// One [[camera]]. `response`: what its response key says; `frames`: the name of its frame list, if
/// it has one.
std::string print_camera(const CameraInfo& camera, const std::string& response,
                         const std::string& frames = {});

/// The cameras of a manifest without frame lists; `response` finds what a camera's key names.
/// `path` names the text in errors. Other keys of the root are the caller's.
/// errors: kUnreadable, kInvalid (file, line, key)
using FindResponse = std::function<Result<calib::Response>(const std::string& name)>;
Result<std::vector<CameraInfo>> read_cameras(const toml::table& root,
                                             const std::filesystem::path& path,
                                             const FindResponse& response);

/// Reads NAME.csv.
/// errors: kNotFound, kInvalid (file and line)
Result<std::vector<FrameRow>> read_frame_list(const std::filesystem::path& folder,
                                              const std::string& list);

/// One line without its header; `with_pose` as the header says, behind which an opacity may follow.
/// errors: kInvalid, `where` is given
Result<FrameRow> parse_row(std::string_view line, bool with_pose, const std::string& where);
std::string print_row(const FrameRow& row);

/// errors: kInvalid (none, a name twice or not made of letters, digits, '-' and '_')
Result<void> check_cameras(const std::vector<CameraInfo>& cameras);
/// `last`: the time of the camera's frame before.
/// errors: kInvalid (no picture, another size, earlier than the last)
Result<void> check_frame(const Frame& frame, const CameraInfo& camera,
                         const std::optional<TimestampNs>& last);

/// What tells the light begins so long before the pictures where a replay does not begin at the
/// start: a bracket's length and more.
inline constexpr Seconds kLightBefore(2);
/// errors: kInvalid (negative, beyond a thousand days)
Result<void> check_from(Seconds from);

/// Whether a path of a capture file stays inside its folder: relative, without "..".
bool stays_inside(const std::filesystem::path& path);

}  // namespace penumbra::capture
#pragma GCC visibility pop
