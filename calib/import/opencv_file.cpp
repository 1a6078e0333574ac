// OpenCV's matrices in a FileStorage, whose names its samples have made a habit, and a camera_info
// of ROS, which has the same matrices.
#include <fmt/format.h>

#include <cmath>

#include "calib/import/internal/import_fields.h"

namespace penumbra::calib {

namespace {

using Names = std::span<const std::string_view>;

std::optional<std::string> first_of(const ImportTable& at, Names names) {
  for (const std::string_view name : names)
    if (at.has(name)) return std::string(name);
  return std::nullopt;
}

// A matrix by rows; OpenCV's and ROS's tables have the same keys, and a plain list is taken, too.
Result<std::vector<double>> read_matrix(const ImportTable& root, const std::string& key,
                                        std::size_t count = 0) {
  const auto table = root.table(key);
  if (!table) return root.numbers(key, count);
  return table->numbers("data", count);
}

Result<void> read_camera_matrix(const ImportTable& root, const std::string& key,
                                ForeignLens& lens) {
  PENUMBRA_ASSIGN(k, read_matrix(root, key, 9));
  constexpr double kSkew = 1e-6;
  if (std::abs(k[1]) > kSkew * std::abs(k[0]) || k[3] != 0 || k[6] != 0 || k[7] != 0 || k[8] != 1)
    return root.invalid(key, "is not fx 0 cx, 0 fy cy, 0 0 1");
  lens.fx = k[0], lens.fy = k[4], lens.cx = k[2], lens.cy = k[5];
  return {};
}

Result<void> read_storage_size(const ImportTable& root, ForeignLens& lens) {
  constexpr std::array<std::string_view, 2> kWidths = {"image_width", "image_Width"};
  constexpr std::array<std::string_view, 2> kHeights = {"image_height", "image_Height"};
  constexpr std::array<std::string_view, 2> kBoth = {"image_size", "imageSize"};
  if (const auto both = first_of(root, kBoth)) {
    PENUMBRA_ASSIGN(size, root.numbers(*both, 2));
    const auto side = [](double v) {
      return v >= 1 && v <= kLargestImportSide ? static_cast<int>(v) : 0;
    };
    lens.width = side(size[0]), lens.height = side(size[1]);
    return {};
  }
  const auto width = first_of(root, kWidths), height = first_of(root, kHeights);
  if (!width || !height)
    return root.invalid("image_width and image_height",
                        "are missing: write the size of the pictures into the file");
  PENUMBRA_ASSIGN(w, root.integer(*width, 1, kLargestImportSide));
  PENUMBRA_ASSIGN(h, root.integer(*height, 1, kLargestImportSide));
  lens.width = w, lens.height = h;
  return {};
}

// OpenCV's calibration sample writes fisheye_model = 1.
bool is_opencv_fisheye(const ImportTable& root) {
  const auto number = root.number("fisheye_model");
  if (number) return *number != 0;
  const auto name = root.text("distortion_model");
  return name && (*name == "fisheye" || *name == "equidistant");
}

Result<ImportedCamera> read_storage_camera(const ImportTable& root, const std::string& name,
                                           const std::string& matrix,
                                           const std::optional<std::string>& distortion) {
  ForeignLens lens;
  if (is_opencv_fisheye(root)) lens.kind = ProjectionKind::kKannalaBrandt;
  PENUMBRA_TRY(read_camera_matrix(root, matrix, lens));
  PENUMBRA_TRY(read_storage_size(root, lens));
  if (distortion) {
    PENUMBRA_ASSIGN(terms, read_matrix(root, *distortion));
    lens.distortion = terms;
  }
  PENUMBRA_ASSIGN(camera, make_imported_lens(root, lens));
  return ImportedCamera{name, name == "camera" ? "" : name, camera, std::nullopt};
}

// Both models of OpenCV have four terms, and many programs write no more.
void note_four_terms(const ImportTable& root, const ImportedCamera& one,
                     const std::optional<std::string>& distortion, ImportedRig& out) {
  if (!distortion || one.camera.kind != ProjectionKind::kPinhole || root.has("fisheye_model") ||
      root.has("distortion_model"))
    return;
  const auto terms = read_matrix(root, *distortion);
  if (terms && terms->size() == 4)
    out.notes.push_back(fmt::format(
        "{}: its four terms of distortion are taken for k1 k2 p1 p2 of a pinhole: of a fisheye, "
        "write fisheye_model: 1 into the file",
        one.name));
}

}  // namespace

Result<std::optional<ImportedRig>> read_opencv_storage(const ImportTable& root) {
  constexpr std::array<std::string_view, 5> kMatrices = {"camera_matrix", "Camera_Matrix",
                                                         "cameraMatrix", "intrinsic_matrix", "K"};
  constexpr std::array<std::string_view, 5> kDistortions = {
      "distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D"};
  constexpr std::array<std::array<std::string_view, 2>, 2> kPairMatrices = {
      {{"M1", "K1"}, {"M2", "K2"}}};
  constexpr std::array<std::array<std::string_view, 1>, 2> kPairDistortions = {{{"D1"}, {"D2"}}};
  ImportedRig out{"OpenCV FileStorage", "", {}};
  if (const auto matrix = first_of(root, kMatrices)) {
    const auto distortion = first_of(root, kDistortions);
    PENUMBRA_ASSIGN(one, read_storage_camera(root, "camera", *matrix, distortion));
    note_four_terms(root, one, distortion, out);
    out.cameras.push_back(std::move(one));
    return out;
  }
  for (std::size_t i = 0; i < 2; ++i) {
    const auto matrix = first_of(root, kPairMatrices[i]);
    if (!matrix) return std::nullopt;
    const auto distortion = first_of(root, kPairDistortions[i]);
    PENUMBRA_ASSIGN(one, read_storage_camera(root, i == 0 ? "left" : "right", *matrix, distortion));
    note_four_terms(root, one, distortion, out);
    out.cameras.push_back(std::move(one));
  }
  if (root.has("R") && root.has("T")) {
    PENUMBRA_ASSIGN(r, read_matrix(root, "R", 9));
    PENUMBRA_ASSIGN(t, read_matrix(root, "T", 3));
    const glm::dmat3 by_rows(r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]);
    PENUMBRA_ASSIGN(q, rotation_of(root, "R", by_rows));
    const Pose right_from_left{q, {t[0], t[1], t[2]}};
    out.cameras[0].body_from_camera = Pose{};
    out.cameras[1].body_from_camera = between_our_cameras(right_from_left.inverse());
    out.body = "first camera";
  }
  return out;
}

namespace {

// Pictures that the driver made smaller, or cut, are not those that were calibrated.
Result<void> check_whole(const ImportTable& root) {
  for (const std::string_view key : {"binning_x", "binning_y"})
    if (const auto v = root.number(key); v && *v > 1)
      return root.invalid(key, fmt::format("is {}: the pictures are smaller than what was "
                                           "calibrated; calibrate them as they come",
                                           *v));
  const auto roi = root.table("roi");
  if (!roi) return {};
  const auto told = [](const ImportTable& at, std::string_view key) {
    return at.number(key).value_or(0);
  };
  // All 0, or the size of the picture, is all of it.
  const bool cuts = told(*roi, "x_offset") > 0 || told(*roi, "y_offset") > 0 ||
                    (told(*roi, "width") > 0 && told(*roi, "width") != told(root, "width")) ||
                    (told(*roi, "height") > 0 && told(*roi, "height") != told(root, "height"));
  if (cuts) return root.invalid("roi", "cuts the pictures; calibrate them as they come");
  return {};
}

}  // namespace

// As a calibration file, or as a message that was printed, by ROS 1 or 2.
Result<std::optional<ImportedRig>> read_ros_camera_info(const ImportTable& root) {
  constexpr std::array<std::string_view, 3> kRosMatrices = {"camera_matrix", "K", "k"};
  constexpr std::array<std::string_view, 3> kRosTerms = {"distortion_coefficients", "D", "d"};
  const auto matrix = first_of(root, kRosMatrices), distortion = first_of(root, kRosTerms);
  const bool message = root.has("width") && root.has("height");
  if (!matrix || !distortion || !root.has("distortion_model") ||
      !(root.has("image_width") || message))
    return std::nullopt;
  PENUMBRA_TRY(check_whole(root));
  PENUMBRA_ASSIGN(model, root.text("distortion_model"));
  ForeignLens lens;
  if (model == "equidistant")
    lens.kind = ProjectionKind::kKannalaBrandt;
  else if (model != "plumb_bob" && model != "rational_polynomial")
    return root.invalid(
        "distortion_model",
        fmt::format("is {}; plumb_bob, rational_polynomial and equidistant can be imported",
                    model));
  PENUMBRA_TRY(read_camera_matrix(root, *matrix, lens));
  if (message) {
    PENUMBRA_ASSIGN(width, root.integer("width", 1, kLargestImportSide));
    PENUMBRA_ASSIGN(height, root.integer("height", 1, kLargestImportSide));
    lens.width = width, lens.height = height;
  } else {
    PENUMBRA_TRY(read_storage_size(root, lens));
  }
  PENUMBRA_ASSIGN(terms, read_matrix(root, *distortion));
  lens.distortion = terms;
  PENUMBRA_ASSIGN(camera, make_imported_lens(root, lens));
  std::string name = "camera";
  if (root.has("camera_name")) {
    PENUMBRA_ASSIGN(given, root.text("camera_name"));
    if (!given.empty()) name = given;
  }
  return ImportedRig{"ROS camera_info", "", {{name, "", camera, std::nullopt}}};
}

}  // namespace penumbra::calib
