// Private to the readers of foreign calibrations: values of a parsed file, and what they make.
// threads: reentrant
#pragma once

#include <array>
#include <filesystem>
#include <glm/mat3x3.hpp>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/camera/camera_model.h"
#include "calib/import/import_camera.h"
#include "core/pose.h"
#include "core/result.h"

namespace penumbra::calib {

/// A table of the file; errors name the file and the way to the key.
class ImportTable {
 public:
  ImportTable(std::string where, const nlohmann::json& node)
      : where_(std::move(where)), node_(node) {}

  std::unexpected<Error> invalid(std::string_view key, const std::string& detail) const;
  bool has(std::string_view key) const { return node_.is_object() && node_.contains(key); }
  const nlohmann::json& node() const { return node_; }
  /// errors: kInvalid (missing, of another kind, not finite) for all of these
  Result<ImportTable> table(std::string_view key) const;
  Result<double> number(std::string_view key) const;
  Result<int> integer(std::string_view key, int low, int high) const;
  Result<std::string> text(std::string_view key) const;
  /// count: 0 for any
  Result<std::vector<double>> numbers(std::string_view key, std::size_t count = 0) const;
  /// Tables of a list, at most sixteen.
  Result<std::vector<ImportTable>> tables(std::string_view key) const;
  /// Rows of four by four numbers that are a rigid transform.
  Result<Pose> transform(std::string_view key) const;

 private:
  Result<const nlohmann::json*> find(std::string_view key) const;

  std::string where_;
  const nlohmann::json& node_;
};

/// What OpenCV, Kalibr, Basalt and ROS state of a lens alike, in their pixels.
struct ForeignLens {
  ProjectionKind kind = ProjectionKind::kPinhole;
  int width = 0, height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;  // cx, cy count from the first pixel's centre
  std::vector<double> distortion;         // kind's terms; a pinhole's may be all fourteen of OpenCV
};
/// errors: kInvalid (size, focal length, terms that Penumbra's pinhole has not, by name)
Result<CameraModel> make_imported_lens(const ImportTable& at, const ForeignLens& lens);

/// errors: kInvalid (not a rotation)
Result<glm::dquat> rotation_of(const ImportTable& at, std::string_view key,
                               const glm::dmat3& matrix);

/// Ours from a camera that looks along +z with y down: half a turn about x.
Pose with_our_camera(const Pose& body_from_camera);
/// Both are such cameras.
Pose between_our_cameras(const Pose& first_from_camera);

inline constexpr int kLargestImportSide = 32768;

// ---- One reader for each format; nothing where the file is of another. ----

Result<std::optional<ImportedRig>> read_valve_index(const ImportTable& root);
Result<std::optional<ImportedRig>> read_kalibr(const ImportTable& root);
Result<std::optional<ImportedRig>> read_basalt(const ImportTable& root);
Result<std::optional<ImportedRig>> read_ros_camera_info(const ImportTable& root);
Result<std::optional<ImportedRig>> read_opencv_storage(const ImportTable& root);

// ---- Texts as trees. ----

/// JSON, YAML, or the XML of OpenCV's FileStorage, by its first sign.
/// errors: kUnreadable (place and reason, nested too deeply, too many values)
Result<nlohmann::json> parse_import_text(std::string_view text, const std::string& where);
Result<nlohmann::json> parse_storage_xml(std::string_view text, const std::string& where);

inline constexpr int kDeepestImport = 64;
inline constexpr int kMaxImportValues = 200'000;

}  // namespace penumbra::calib
