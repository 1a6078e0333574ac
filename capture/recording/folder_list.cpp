#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <cstdint>

#include "capture/recording/folder_format.h"
#include "core/io/files.h"

namespace penumbra::capture {
namespace fs = std::filesystem;
namespace {

std::string_view trim(std::string_view text) {
  constexpr std::string_view blanks = " \t\r";
  const auto first = text.find_first_not_of(blanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(blanks) - first + 1);
}

std::vector<std::string_view> split(std::string_view line) {
  std::vector<std::string_view> fields;
  for (;;) {
    const auto comma = line.find(',');
    fields.push_back(trim(line.substr(0, comma)));
    if (comma == std::string_view::npos) return fields;
    line.remove_prefix(comma + 1);
  }
}

std::optional<double> to_number(std::string_view text) {
  double value = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || stop != text.data() + text.size() || !std::isfinite(value))
    return std::nullopt;
  return value;
}

/// Digit by digit: a double would lose the last nanoseconds of times that count from 1970.
TimestampNs exact_time(std::string_view decimal) {
  const bool negative = decimal.starts_with('-');
  const auto point = decimal.find('.');
  std::int64_t value = 0;
  for (const char c : decimal.substr(0, point))
    if (c != '-') value = value * 10 + (c - '0');
  std::string_view digits;
  if (point != std::string_view::npos) digits = decimal.substr(point + 1);
  for (std::size_t i = 0; i < 9; ++i)
    value = value * 10 + (i < digits.size() ? digits[i] - '0' : 0);
  if (digits.size() > 9 && digits[9] >= '5') ++value;
  return {negative ? -value : value};
}

std::optional<TimestampNs> to_time(std::string_view text) {
  constexpr double limit_s = 9e9;  // 64 bit nanoseconds end at 9.2e9 s
  const auto seconds = to_number(text);
  if (!seconds || std::abs(*seconds) > limit_s) return std::nullopt;
  if (text.find_first_of("eE") != std::string_view::npos)
    return TimestampNs{std::llround(*seconds * 1e9)};
  return exact_time(text);
}

std::string print_time(TimestampNs time) {
  constexpr std::int64_t second = 1'000'000'000;
  const bool negative = time.value < 0;
  const std::int64_t whole = std::abs(time.value / second), part = std::abs(time.value % second);
  return fmt::format("{}{}.{:09}", negative ? "-" : "", whole, part);
}

Result<Pose> parse_pose(std::span<const std::string_view> fields, const std::string& where) {
  constexpr std::string_view names[] = {"tx", "ty", "tz", "qx", "qy", "qz", "qw"};
  double v[7];
  for (std::size_t i = 0; i < 7; ++i) {
    const auto number = to_number(fields[i]);
    if (!number)
      return fail(ErrorCode::kInvalid, where,
                  fmt::format("{} is \"{}\" and not a finite number", names[i], fields[i]));
    v[i] = *number;
  }
  Pose pose{glm::dquat(v[6], v[3], v[4], v[5]), {v[0], v[1], v[2]}};
  const double length = glm::length(pose.rotation);
  if (std::abs(length - 1) > 1e-3)
    return fail(ErrorCode::kInvalid, where,
                fmt::format("qx,qy,qz,qw has length {:.4g} instead of 1", length));
  // What is already as good as a double allows keeps its bits.
  if (std::abs(length - 1) > 1e-12) pose.rotation = glm::normalize(pose.rotation);
  return pose;
}

Result<bool> parse_header(std::string_view line, const std::string& where) {
  const std::string full = std::string(kListHeader) + std::string(kPoseHeader);
  std::string compact;
  for (const auto field : split(line)) {
    if (!compact.empty()) compact += ',';
    compact += field;
  }
  if (compact == kListHeader) return false;
  if (compact == full || compact == full + std::string(kOpacityHeader)) return true;
  return fail(ErrorCode::kInvalid, where,
              fmt::format("header is \"{}\" instead of \"{}\", \"{}\" or the latter with \"{}\"",
                          line, kListHeader, full, kOpacityHeader));
}

Result<void> check_after(const FrameRow& row, const std::vector<FrameRow>& rows,
                         const std::string& where) {
  if (rows.empty() || row.time >= rows.back().time) return {};
  return fail(ErrorCode::kInvalid, where,
              fmt::format("time_s {} is before the previous frame's {}", print_time(row.time),
                          print_time(rows.back().time)));
}

Result<void> check_present(const fs::path& folder, const FrameRow& row, const std::string& where) {
  std::error_code ignored;
  if (fs::is_regular_file(folder / row.file, ignored)) return {};
  return fail(ErrorCode::kNotFound, where, row.file + " does not exist");
}

}  // namespace

bool stays_inside(const fs::path& path) {
  if (path.empty() || path.has_root_path()) return false;
  for (const fs::path& part : path)
    if (part == "..") return false;
  return true;
}

Result<FrameRow> parse_row(std::string_view line, bool with_pose, const std::string& where) {
  const auto invalid = [&](std::string detail) {
    return fail(ErrorCode::kInvalid, where, std::move(detail));
  };
  const auto fields = split(line);
  const std::size_t expected = with_pose ? 11 : 4;
  const bool with_opacity = with_pose && fields.size() == expected + 1;
  if (fields.size() != expected && !with_opacity)
    return invalid(fmt::format("has {} fields instead of {}", fields.size(), expected));
  FrameRow row;
  row.file = std::string(fields[0]);
  if (!stays_inside(row.file))
    return invalid(fmt::format("file \"{}\" is not a path inside the folder", row.file));
  const auto time = to_time(fields[1]);
  if (!time)
    return invalid(fmt::format("time_s is \"{}\" and not a number within -9e9..9e9", fields[1]));
  row.time = *time;
  const auto seconds = to_number(fields[2]);
  if (!seconds || *seconds <= 0)
    return invalid(fmt::format("exposure_s is \"{}\" and not a positive number", fields[2]));
  const auto gain = to_number(fields[3]);
  if (!gain || *gain <= 0)
    return invalid(fmt::format("gain is \"{}\" and not a positive number", fields[3]));
  row.exposure = {Seconds(*seconds), Gain(*gain)};
  if (!with_pose) return row;
  PENUMBRA_ASSIGN(pose, parse_pose(std::span(fields).subspan(4), where));
  row.pose = pose;
  if (!with_opacity) return row;
  const auto opacity = to_number(fields.back());
  if (!opacity || *opacity < 0 || *opacity > 1)
    return invalid(fmt::format("opacity is \"{}\" and not within 0..1", fields.back()));
  row.opacity = static_cast<float>(*opacity);
  return row;
}

std::string print_row(const FrameRow& row) {
  // {} prints the shortest text that reads back to the same double.
  std::string text = fmt::format("{},{},{},{}", row.file, print_time(row.time),
                                 row.exposure.time.count(), row.exposure.gain.value());
  if (!row.pose) return text;
  const auto& [q, t] = *row.pose;
  text += fmt::format(",{},{},{},{},{},{},{}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
  return row.opacity < 1 ? text + fmt::format(",{}", row.opacity) : text;
}

Result<std::vector<FrameRow>> read_frame_list(const fs::path& folder, const std::string& list) {
  const fs::path path = folder / list;
  PENUMBRA_ASSIGN(whole, read_text(path, std::size_t{1} << 28));
  std::string_view text = whole;
  std::vector<FrameRow> rows;
  std::optional<bool> with_pose;
  for (int number = 1; !text.empty(); ++number) {
    const auto end = text.find('\n');
    const std::string_view line = trim(text.substr(0, end));
    text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
    const std::string where = fmt::format("{}:{}", path.string(), number);
    if (!with_pose) {
      PENUMBRA_ASSIGN(header, parse_header(line, where));
      with_pose = header;
      continue;
    }
    if (line.empty()) continue;
    PENUMBRA_ASSIGN(row, parse_row(line, *with_pose, where));
    PENUMBRA_TRY(check_after(row, rows, where));
    PENUMBRA_TRY(check_present(folder, row, where));
    rows.push_back(std::move(row));
  }
  if (!with_pose)
    return fail(ErrorCode::kInvalid, path.string() + ":1",
                fmt::format("header is missing: it is \"{}\"", kListHeader));
  return rows;
}

}  // namespace penumbra::capture
