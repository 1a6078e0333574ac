#include "tools/calibrate/tracker_file.h"

#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "core/io/files.h"

namespace penumbra::tools {

namespace {

constexpr std::string_view kHeader = "time_s,tx,ty,tz,qx,qy,qz,qw";
using Row = std::array<double, 8>;

std::optional<Row> parse(std::string_view line) {
  Row out{};
  for (std::size_t i = 0; i < out.size(); ++i) {
    const std::size_t comma = i + 1 < out.size() ? line.find(',') : line.size();
    if (comma == std::string_view::npos) return std::nullopt;
    const auto [end, error] = std::from_chars(line.data(), line.data() + comma, out[i]);
    if (error != std::errc() || end != line.data() + comma || !std::isfinite(out[i]))
      return std::nullopt;
    line.remove_prefix(std::min(comma + 1, line.size()));
  }
  return out;
}

}  // namespace

Result<std::vector<calib::TrackerPose>> read_tracker_file(const std::filesystem::path& path) {
  PENUMBRA_ASSIGN(whole, read_text(path));
  std::string_view text = whole;
  std::vector<calib::TrackerPose> out;
  constexpr double kUnit = 1e-2;  // that a quaternion's length may be off by
  for (int number = 1; !text.empty(); ++number) {
    std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(line.size() + 1, text.size()));
    if (line.ends_with('\r')) line.remove_suffix(1);
    const auto invalid = [&](const std::string& detail) {
      return fail(ErrorCode::kInvalid, fmt::format("{}:{}", path.string(), number), detail);
    };
    if (number == 1) {
      if (line != kHeader) return invalid(fmt::format("is not the header {}", kHeader));
      continue;
    }
    if (line.empty()) continue;
    const auto row = parse(line);
    if (!row) return invalid("does not have eight numbers");
    const auto& r = *row;
    const glm::dquat q(r[7], r[4], r[5], r[6]);
    if (std::abs(glm::length(q) - 1) > kUnit)
      return invalid("has a quaternion that is not of unit length");
    if (!out.empty() && !(r[0] > out.back().time_s))
      return invalid("is not later than the line before");
    out.push_back({r[0], {glm::normalize(q), {r[1], r[2], r[3]}}});
  }
  if (out.empty()) return fail(ErrorCode::kInvalid, path.string(), "has no pose");
  return out;
}

}  // namespace penumbra::tools
