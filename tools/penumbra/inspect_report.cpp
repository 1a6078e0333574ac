#include "tools/penumbra/inspect_report.h"

#include <fmt/format.h>

#include <cmath>
#include <sstream>
#include <string_view>

#include "calib/estimate/boards.h"
#include "core/io/files.h"

namespace penumbra::tools {

namespace {

Result<std::string> read_text(const std::string& file) {
  PENUMBRA_ASSIGN(bytes, read_bytes(file));
  return std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size());
}

// What stands between two texts, the first of them found first; empty without both.
std::string_view between(std::string_view text, std::string_view before, std::string_view after) {
  const std::size_t from = text.find(before);
  if (from == std::string_view::npos) return {};
  text.remove_prefix(from + before.size());
  const std::size_t to = text.find(after);
  return to == std::string_view::npos ? std::string_view() : text.substr(0, to);
}

}  // namespace

Result<nlohmann::json> inspect_table(const std::string& file) {
  PENUMBRA_ASSIGN(text, read_text(file));
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (text.starts_with(kByteOrderMark)) text.erase(0, kByteOrderMark.size());
  std::istringstream lines(text);
  std::string line;
  if (text.find('\0') != std::string::npos || !std::getline(lines, line) ||
      line.find_first_not_of(", \r") == std::string::npos)
    return fail(ErrorCode::kUnreadable, file, "is no table: its first line names no columns");
  nlohmann::json columns = nlohmann::json::array();
  std::istringstream names(line.substr(0, line.find_last_not_of(" \r") + 1));
  for (std::string name; std::getline(names, name, ',');) columns.push_back(name);
  std::size_t rows = 0;
  while (std::getline(lines, line)) rows += line.find_first_not_of(" \r") != std::string::npos;
  return nlohmann::json{{"kind", "table"}, {"columns", columns}, {"rows", rows}};
}

Result<nlohmann::json> inspect_plot(const std::string& file) {
  PENUMBRA_ASSIGN(text, read_text(file));
  const std::string_view head = between(text, "<svg", ">");
  if (head.empty()) return fail(ErrorCode::kUnreadable, file, "is no SVG");
  nlohmann::json out = {{"kind", "plot"}};
  for (const char* const side : {"width", "height"})
    if (const auto value = between(head, fmt::format(" {}=\"", side), "\""); !value.empty())
      out[side] = value;
  if (const auto title = between(text, "<title>", "</title>"); !title.empty()) out["title"] = title;
  return out;
}

Result<nlohmann::json> inspect_page(const std::string& file) {
  PENUMBRA_ASSIGN(text, read_text(file));
  const std::string board(between(text, "(--board ", ")"));
  if (!text.starts_with("%PDF-") || !calib::parse_board(board))
    return fail(ErrorCode::kUnreadable, file, "is no page of a calibration board");
  nlohmann::json out = {{"kind", "calibration board"}, {"board", board}};
  std::istringstream box(std::string(between(text, "/MediaBox [", "]")));
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  constexpr double kMm_per_point = 25.4 / 72;
  if (box >> x0 >> y0 >> x1 >> y1)
    out["page_mm"] = {std::round((x1 - x0) * kMm_per_point), std::round((y1 - y0) * kMm_per_point)};
  return out;
}

}  // namespace penumbra::tools
