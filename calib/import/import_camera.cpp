#include "calib/import/import_camera.h"

#include <exception>

#include "calib/import/internal/import_fields.h"
#include "core/exceptions.h"
#include "core/io/files.h"

namespace penumbra::calib {

namespace {

Result<ImportedRig> read_any_format(std::string_view text, const std::string& where) {
  PENUMBRA_ASSIGN(tree, parse_import_text(text, where));
  const ImportTable root(where, tree);
  // OpenCV's last: others have matrices of the same names.
  for (const auto& read :
       {read_valve_index, read_basalt, read_kalibr, read_ros_camera_info, read_opencv_storage}) {
    PENUMBRA_ASSIGN(rig, read(root));
    if (rig) return *rig;
  }
  return fail(ErrorCode::kInvalid, where,
              "is no calibration of the Valve Index, Kalibr, Basalt, ROS or OpenCV");
}

}  // namespace

Result<ImportedRig> parse_camera_import(std::string_view text, const std::filesystem::path& path) {
  try {
    return read_any_format(text, path.string());
  } catch (const std::exception& e) {
    return fail(ErrorCode::kUnreadable, path.string(), reason_of(e));
  }
}

Result<ImportedRig> import_camera(const std::filesystem::path& path) {
  constexpr std::size_t kLargestFile = std::size_t{4} << 20;
  PENUMBRA_ASSIGN(text, read_text(path, kLargestFile));
  return parse_camera_import(text, path);
}

}  // namespace penumbra::calib
