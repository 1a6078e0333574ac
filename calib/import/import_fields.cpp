#include "calib/import/internal/import_fields.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/gtc/quaternion.hpp>
#include <glm/matrix.hpp>

namespace penumbra::calib {

namespace {

using nlohmann::json;

constexpr double kLargestPixels = 1e6;

// Text holds numbers where XML has them.
std::optional<double> finite_number(const json& node) {
  if (node.is_number()) {
    const double value = node.get<double>();
    return std::isfinite(value) ? std::optional(value) : std::nullopt;
  }
  if (!node.is_string()) return std::nullopt;
  const auto& text = node.get_ref<const std::string&>();
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value))
    return std::nullopt;
  return value;
}

// Also of lists in lists, and of text with numbers between blanks.
bool append_numbers(const json& node, std::vector<double>& out) {
  constexpr std::size_t kMost = 4096;
  if (out.size() > kMost) return false;
  if (node.is_array()) {
    for (const json& one : node)
      if (!append_numbers(one, out)) return false;
    return true;
  }
  if (!node.is_string()) {
    const auto value = finite_number(node);
    if (value) out.push_back(*value);
    return value.has_value();
  }
  std::string_view text = node.get_ref<const std::string&>();
  constexpr std::string_view kBlanks = " \t\r\n";
  while (true) {
    text.remove_prefix(std::min(text.find_first_not_of(kBlanks), text.size()));
    if (text.empty()) return true;
    const std::string_view word = text.substr(0, text.find_first_of(kBlanks));
    const auto value = finite_number(json(std::string(word)));
    if (!value || out.size() > kMost) return false;
    out.push_back(*value);
    text.remove_prefix(word.size());
  }
}

}  // namespace

std::unexpected<Error> ImportTable::invalid(std::string_view key, const std::string& detail) const {
  return fail(ErrorCode::kInvalid, where_, fmt::format("{}: {}", key, detail));
}

Result<const json*> ImportTable::find(std::string_view key) const {
  if (!has(key)) return invalid(key, "is missing");
  return &node_.at(std::string(key));
}

Result<ImportTable> ImportTable::table(std::string_view key) const {
  PENUMBRA_ASSIGN(node, find(key));
  if (!node->is_object()) return invalid(key, "is not a table");
  return ImportTable(fmt::format("{}: {}", where_, key), *node);
}

Result<double> ImportTable::number(std::string_view key) const {
  PENUMBRA_ASSIGN(node, find(key));
  const auto value = finite_number(*node);
  if (!value) return invalid(key, "is not a finite number");
  return *value;
}

Result<int> ImportTable::integer(std::string_view key, int low, int high) const {
  PENUMBRA_ASSIGN(value, number(key));
  if (!(value >= low && value <= high) || value != std::floor(value))
    return invalid(key, fmt::format("is not a whole number within {}..{}", low, high));
  return static_cast<int>(value);
}

Result<std::string> ImportTable::text(std::string_view key) const {
  PENUMBRA_ASSIGN(node, find(key));
  if (!node->is_string()) return invalid(key, "is not text");
  constexpr std::size_t kLongest = 200;
  const auto& value = node->get_ref<const std::string&>();
  if (value.size() > kLongest) return invalid(key, "is text of more than 200 bytes");
  return value;
}

Result<std::vector<double>> ImportTable::numbers(std::string_view key, std::size_t count) const {
  PENUMBRA_ASSIGN(node, find(key));
  std::vector<double> out;
  if (!(node->is_array() || node->is_string()) || !append_numbers(*node, out))
    return invalid(key, "is not a list of finite numbers");
  if (count != 0 && out.size() != count)
    return invalid(key, fmt::format("has {} numbers instead of {}", out.size(), count));
  return out;
}

Result<std::vector<ImportTable>> ImportTable::tables(std::string_view key) const {
  PENUMBRA_ASSIGN(node, find(key));
  constexpr std::size_t kMost = 16;
  if (!node->is_array() || node->empty() || node->size() > kMost)
    return invalid(key, "is not a list of 1 to 16 tables");
  std::vector<ImportTable> out;
  for (std::size_t i = 0; i < node->size(); ++i) {
    if (!(*node)[i].is_object()) return invalid(key, "is not a list of tables");
    out.emplace_back(fmt::format("{}: {}[{}]", where_, key, i), (*node)[i]);
  }
  return out;
}

Result<glm::dquat> rotation_of(const ImportTable& at, std::string_view key, const glm::dmat3& m) {
  constexpr double kLoose = 1e-2;  // files round their numbers
  const glm::dmat3 off = glm::transpose(m) * m - glm::dmat3(1);
  double largest = 0;
  for (int c = 0; c < 3; ++c)
    for (int r = 0; r < 3; ++r) largest = std::max(largest, std::abs(off[c][r]));
  if (!(largest < kLoose) || !(glm::determinant(m) > 0))
    return at.invalid(key, "is not a rotation");
  return glm::normalize(glm::quat_cast(m));
}

Result<Pose> ImportTable::transform(std::string_view key) const {
  PENUMBRA_ASSIGN(v, numbers(key, 16));
  if (v[12] != 0 || v[13] != 0 || v[14] != 0 || v[15] != 1)
    return invalid(key, "does not end with the row 0 0 0 1");
  glm::dmat3 m;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) m[c][r] = v[static_cast<std::size_t>(4 * r + c)];
  PENUMBRA_ASSIGN(q, rotation_of(*this, key, m));
  return Pose{q, {v[3], v[7], v[11]}};
}

Result<CameraModel> make_imported_lens(const ImportTable& at, const ForeignLens& lens) {
  auto made = make_projection(lens.kind, lens.width, lens.height);
  if (!made) return at.invalid("size", made.error().detail);
  const auto is_length = [](double f) { return f > 0 && f < kLargestPixels; };
  if (!is_length(lens.fx) || !is_length(lens.fy))
    return at.invalid("focal length", "is not within 0..1000000 pixels");
  if (!(std::abs(lens.cx) < kLargestPixels && std::abs(lens.cy) < kLargestPixels))
    return at.invalid("principal point", "is not within a million pixels");
  made->focal_px = {lens.fx, lens.fy};
  made->principal_px = {lens.cx + .5, lens.cy + .5};
  const auto own = static_cast<std::size_t>(distortion_count(lens.kind));
  constexpr std::array<std::string_view, 14> kOpenCvTerms = {
      "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"};
  for (std::size_t i = own; i < lens.distortion.size(); ++i)
    if (lens.distortion[i] != 0)
      return at.invalid(
          "distortion",
          lens.kind == ProjectionKind::kPinhole && i < kOpenCvTerms.size()
              ? fmt::format("has {}, but a pinhole has k1 k2 p1 p2 k3 alone: calibrate it without "
                            "the rational, thin prism and tilt terms",
                            kOpenCvTerms[i])
              : fmt::format("has {} terms instead of {}", lens.distortion.size(), own));
  auto whole = with_distortion(*made, lens.distortion);
  if (!whole) return at.invalid("distortion", whole.error().detail);
  return *whole;
}

Pose with_our_camera(const Pose& body_from_camera) {
  return body_from_camera * Pose{{0, 1, 0, 0}, {0, 0, 0}};
}

Pose between_our_cameras(const Pose& first_from_camera) {
  const Pose half_turn{{0, 1, 0, 0}, {0, 0, 0}};
  return half_turn.inverse() * first_from_camera * half_turn;
}

}  // namespace penumbra::calib
