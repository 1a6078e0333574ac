#include <fmt/format.h>

#include <algorithm>

#include "capture/frames.h"
#include "capture/recording/camera_table.h"
#include "capture/recording/folder.h"
#include "capture/recording/folder_format.h"
#include "codec/codec.h"
#include "core/io/toml_keys.h"

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

Result<FolderCamera> read_camera(const TomlKeys& keys) {
  FolderCamera camera;
  const fs::path folder = keys.path().parent_path();
  PENUMBRA_TRY(keys.only(kCameraKeys));
  PENUMBRA_ASSIGN(info, read_camera_info(keys));
  camera.info = std::move(info);
  PENUMBRA_ASSIGN(list, keys.text("frames"));
  if (!stays_inside(list))
    return keys.invalid("frames", fmt::format("\"{}\" is not a path inside the folder", list));
  PENUMBRA_ASSIGN(rows, read_frame_list(folder, list));
  camera.rows = std::move(rows);
  if (!sees_light(camera.info.role)) return camera;
  PENUMBRA_ASSIGN(response, read_response(keys, camera.rows));
  camera.info.response = response;
  PENUMBRA_TRY(read_white_balance(keys, camera.info.response));
  return camera;
}

}  // namespace

Result<std::vector<FolderCamera>> read_manifest(const fs::path& folder) {
  const fs::path path = folder / kManifestName;
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "camera"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  if (list.empty()) return keys.invalid("camera", "needs at least one table [[camera]]");
  std::vector<FolderCamera> cameras;
  for (const toml::table* table : list) {
    const TomlKeys camera_keys(path, *table);
    PENUMBRA_ASSIGN(camera, read_camera(camera_keys));
    if (std::ranges::any_of(cameras,
                            [&](const auto& c) { return c.info.name == camera.info.name; }))
      return camera_keys.invalid("name", fmt::format("\"{}\" is used twice", camera.info.name));
    cameras.push_back(std::move(camera));
  }
  if (std::ranges::all_of(cameras, [](const auto& c) { return c.rows.empty(); }))
    return fail(ErrorCode::kInvalid, path.string(), "no camera has a frame");
  return cameras;
}

Result<std::vector<CameraInfo>> read_cameras(const toml::table& root, const fs::path& path,
                                             const FindResponse& response) {
  const TomlKeys keys(path, root);
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  if (list.empty()) return keys.invalid("camera", "needs at least one table [[camera]]");
  std::vector<CameraInfo> cameras;
  for (const toml::table* table : list) {
    const TomlKeys camera_keys(path, *table);
    PENUMBRA_TRY(camera_keys.only(kCameraKeys));
    PENUMBRA_ASSIGN(info, read_camera_info(camera_keys));
    if (sees_light(info.role)) {
      PENUMBRA_ASSIGN(name, camera_keys.text("response"));
      PENUMBRA_ASSIGN(found, response(name));
      info.response = found;
      PENUMBRA_TRY(read_white_balance(camera_keys, info.response));
    }
    if (std::ranges::any_of(cameras, [&](const auto& c) { return c.name == info.name; }))
      return camera_keys.invalid("name", fmt::format("\"{}\" is used twice", info.name));
    cameras.push_back(std::move(info));
  }
  return cameras;
}

Result<CameraInfo> read_camera_file(const fs::path& path) {
  PENUMBRA_ASSIGN(root, parse_toml(path));
  const TomlKeys keys(path, root);
  constexpr std::string_view known[] = {"version", "camera", "calibration"};
  PENUMBRA_TRY(keys.only(known));
  PENUMBRA_TRY(keys.version(1));
  PENUMBRA_ASSIGN(list, keys.tables("camera"));
  if (list.size() != 1)
    return keys.invalid("camera", fmt::format("has {} cameras instead of one", list.size()));
  const TomlKeys camera_keys(path, *list[0]);
  PENUMBRA_TRY(camera_keys.only(kCameraKeys));
  return read_camera_info(camera_keys);
}

std::string print_manifest(const std::vector<CameraInfo>& cameras,
                           const std::vector<std::string>& responses) {
  std::string text = "version = 1\n";
  for (std::size_t i = 0; i < cameras.size(); ++i)
    text += print_camera(cameras[i], responses[i], cameras[i].name + ".csv");
  return text;
}

}  // namespace penumbra::capture
